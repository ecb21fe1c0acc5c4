"""Training of KNet: resumable, the same samples for the same seed however often it is interrupted."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch.utils.data import DataLoader, Dataset

from fgrecon.perception.keypoints.crops import MARGIN
from fgrecon.perception.keypoints.detect import REACH
from fgrecon.perception.keypoints.layout import KINDS, STRIDE, KNetSettings
from fgrecon_research.training.keypoints.augment import Sample, Street
from fgrecon_research.training.keypoints.dataset import Photographs
from fgrecon_research.training.keypoints.deform import Partner
from fgrecon_research.training.keypoints.knet import KNet, load_imagenet
from fgrecon_research.training.keypoints.labels import SEEN
from fgrecon_research.training.keypoints.losses import knet_loss
from fgrecon_research.training.keypoints.trainer import Schedule, Trainer, TrainingProgress
from fgrecon_research.training.keypoints.views import TrainingSet, azimuth_weights

_CLIP = 5.0  # largest norm of a step's gradient


@dataclass(frozen=True)
class Training(Schedule):
    """How KNet is trained: see `Schedule`; the pretrained encoder's learning rate is half of the others'."""

    sigma: float = 2.5  # standard deviation of the target Gaussians, pixels of the crop
    network: KNetSettings = field(default_factory=lambda: KNetSettings(kinds=len(KINDS)))  # sizes
    street: Street = field(default_factory=Street)  # augmentation


class _Samples(Dataset):  # type: ignore[misc]
    """Sample number i of the training, whichever step or process asks for it."""

    def __init__(self, learning: TrainingSet, partner: Partner, how: Training) -> None:
        self.learning, self.partner, self.how = learning, partner, how

    def __getitem__(self, number: int) -> tuple[Any, ...]:
        drawn = self.learning.draw(self.how.street, self.partner, (self.how.seed, int(number)))
        numbers = (drawn.keypoints, drawn.visible, np.array(drawn.azimuth))
        return (torch.from_numpy(drawn.crop), *(torch.from_numpy(n.astype(np.float32)) for n in numbers), drawn.kind)


def first_network(
    how: Training, imagenet: dict[str, Any] | None = None, start: Mapping[str, Any] | None = None
) -> KNet:
    """The network that a training begins with: random by its seed, but for weights of the encoder or of a whole one."""
    torch.manual_seed(how.seed)
    network = KNet(how.network)
    if imagenet is not None:
        load_imagenet(network, imagenet)
    if start is not None:
        network.load_state_dict(start, strict=False)
    return network


def train_knet(
    network: KNet,
    learning: TrainingSet,
    partner: Partner,
    checkpoint: Path,
    how: Training,
    *,
    report: Callable[[TrainingProgress], None] | None = None,
    until: int | None = None,
    held: HeldOut | None = None,
) -> KNet:
    """Train, or go on where the checkpoint ends.

    Args:
        network: `first_network`.
        until: Step after which to end with a checkpoint; None for the last.

    Returns:
        The averaged network, in evaluation mode.
    """
    device = how.device
    network.to(device=device, memory_format=torch.channels_last)
    score = None if held is None else partial(held.score, device=device)
    trainer = Trainer(network, _groups(network), how, checkpoint, how.network.to_dict(), report, score)

    def losses(batch: Sequence[Any]) -> dict[str, Any]:
        crops, points, visible, azimuth, kind = (part.to(device) for part in batch)
        crops = crops.permute(0, 3, 1, 2).float()
        with torch.autocast(device, dtype=torch.bfloat16, enabled=device != "cpu"):
            output = network(crops)
        return knet_loss(output, points, visible, azimuth, kind, how.sigma)

    samples = _Samples(learning, partner, how)
    return trainer.run(_batches(samples, how, trainer.done), losses, clip=_CLIP, until=until)


def _groups(network: KNet) -> list[dict[str, Any]]:
    """The parameters for the optimizer: those of the encoder learn at half the rate."""
    encoder = [p for part in (network.stem, network.stages) for p in part.parameters()]
    inner = {id(p) for p in encoder}
    others = [p for p in network.parameters() if id(p) not in inner]
    return [{"params": encoder, "share": 0.5}, {"params": others, "share": 1.0}]


def _batches(samples: _Samples, how: Training, first: int) -> Iterator[Any]:
    # A worker is one thread: the cores belong to the network. OpenCV's threads must end before processes are forked: a
    # worker that inherits them waits for them for ever.
    cv2.setNumThreads(1)
    numbers = range(first * how.batch, how.steps * how.batch)
    yield from DataLoader(
        samples,
        batch_size=how.batch,
        sampler=list(numbers),
        num_workers=how.workers,
        prefetch_factor=4 if how.workers else None,
    )


# How well a network does on photographs that it does not learn from, while it is trained.

_BATCH = 32
_SEED = 12_000_000  # of the samples


@dataclass(frozen=True)
class HeldOut:
    """Samples of held-out photographs, drawn once."""

    samples: Sequence[Sample]  # degraded as those that are learnt from

    @classmethod
    def draw(
        cls,
        photographs: Photographs,
        held: NDArray[np.intp],
        street: Street,
        partner: Partner,
        seed: int,
        count: int = 192,
    ) -> HeldOut:
        """Draw them, all directions about equally often."""
        weights = azimuth_weights(photographs.azimuth, held)
        return cls([photographs.draw(held, weights, street, partner, (seed, _SEED + i)) for i in range(count)])

    def score(self, network: Any, device: str = "cpu") -> float:
        """PCK at 0.1: share of visible keypoints that KNet (evaluating) puts so near; NaN if none is."""
        hits: list[NDArray[np.bool_]] = []
        for start in range(0, len(self.samples), _BATCH):
            some = self.samples[start : start + _BATCH]
            crops = torch.from_numpy(np.stack([sample.crop for sample in some])).to(device)
            with torch.inference_mode():
                maps = network(crops.permute(0, 3, 1, 2).float()).maps.float().cpu().numpy()
            row, column = np.divmod(maps.reshape(*maps.shape[:2], -1).argmax(axis=-1), maps.shape[-1])
            places = (np.stack([column, row], axis=-1) + 0.5) * STRIDE - 0.5
            points = np.array([sample.keypoints for sample in some])
            away = np.linalg.norm(places - points, axis=-1) / (maps.shape[-1] * STRIDE / MARGIN)
            visible = (np.array([sample.visible for sample in some]) > SEEN) & np.isfinite(away)
            hits.append((away <= REACH)[visible])
        found = np.concatenate(hits)
        return float(found.mean()) if len(found) else float("nan")
