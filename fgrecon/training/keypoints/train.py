"""Training of KNet: resumable, the same samples for the same seed however often it is interrupted."""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch.utils.data import DataLoader, Dataset

from fgrecon.perception.keypoints.knet import KNet, KNetSettings, load_imagenet
from fgrecon.training.keypoints.augment import Street
from fgrecon.training.keypoints.checkpoint import follow, restore_checkpoint, save_checkpoint
from fgrecon.training.keypoints.dataset import Photographs
from fgrecon.training.keypoints.losses import knet_loss
from fgrecon.training.keypoints.validate import HeldOut

__all__ = ["Training", "TrainingProgress", "train_knet"]

Array = NDArray[np.float64]

_CLIP = 5.0  # largest norm of a step's gradient


@dataclass(frozen=True)
class Training:
    """How KNet is trained.

    Attributes:
        steps: Gradient steps in all; the last `decay` of them lower the rate to zero.
        decay: Share of the steps.
        batch: Samples per step.
        rate: Learning rate; the pretrained encoder's is half of it.
        warmup: Steps over which the rate rises.
        sigma: Standard deviation of the target Gaussians, pixels of the crop.
        average: Decay per step of the moving average of the weights, which is what is kept.
        seed: Of samples and first weights.
        save_every: Steps between checkpoints.
        workers: Processes that make samples; 0 makes them in this one.
        network: Sizes.
        street: Augmentation.
    """

    steps: int = 4000
    decay: float = 0.25
    batch: int = 32
    rate: float = 1e-3
    warmup: int = 100
    sigma: float = 2.5
    average: float = 0.998
    seed: int = 0
    save_every: int = 100
    workers: int = 1
    network: KNetSettings = field(default_factory=KNetSettings)
    street: Street = field(default_factory=Street)

    def rate_at(self, step: int) -> float:
        """Learning rate of a step: up, level, and down to zero."""
        start = round(self.steps * (1.0 - self.decay))
        down = 1.0 if step < start else (self.steps - step) / max(self.steps - start, 1)
        return self.rate * min(1.0, (step + 1) / max(self.warmup, 1)) * max(down, 0.0)


@dataclass(frozen=True)
class TrainingProgress:
    """A step's losses, for display.

    Attributes:
        step: Steps done.
        steps: Of how many.
        losses: Mean of each part of the loss since the last report.
        score: PCK at 0.1 of the averaged network on samples of held-out photographs; None where there are none.
    """

    step: int
    steps: int
    losses: dict[str, float]
    score: float | None = None


class _Samples(Dataset):  # type: ignore[misc]
    """Sample number i of the training, whichever step or process asks for it."""

    def __init__(
        self,
        photographs: Photographs,
        chosen: NDArray[np.intp],
        weights: Array,
        partner: NDArray[np.intp],
        how: Training,
    ) -> None:
        self.photographs, self.chosen, self.weights, self.partner, self.how = photographs, chosen, weights, partner, how

    def __getitem__(self, number: int) -> tuple[Any, ...]:
        drawn = self.photographs.draw(
            self.chosen, self.weights, self.how.street, self.partner, (self.how.seed, int(number))
        )
        numbers = (drawn.keypoints, drawn.visible, np.array(drawn.azimuth))
        return (torch.from_numpy(drawn.crop), *(torch.from_numpy(n.astype(np.float32)) for n in numbers))


def train_knet(
    photographs: Photographs,
    chosen: NDArray[np.intp],
    weights: Array,
    partner: NDArray[np.intp],
    checkpoint: Path,
    how: Training,
    *,
    imagenet: dict[str, Any] | None = None,
    start: dict[str, Any] | None = None,
    device: str = "cpu",
    report: Callable[[TrainingProgress], None] | None = None,
    until: int | None = None,
    held: HeldOut | None = None,
) -> KNet:
    """Train, or go on where the checkpoint ends.

    Args:
        photographs: Prepared photographs with labels.
        chosen: Which of them to learn from.
        weights: How often to draw each.
        partner: (K,) index of each keypoint's mirror image.
        checkpoint: File to go on from and to write to.
        how: Settings.
        imagenet: Weights to start the encoder from, without a checkpoint.
        start: Weights of a whole network to start from instead.
        device: Torch's name of the device; mixed precision on a GPU.
        report: Called after every `save_every` steps.
        until: Step after which to end with a checkpoint; None for the last.
        held: What the averaged network is scored on for the report.

    Returns:
        The averaged network, in evaluation mode.
    """
    torch.manual_seed(how.seed)
    network = KNet(how.network)
    if imagenet is not None:
        load_imagenet(network, imagenet)
    if start is not None:
        network.load_state_dict(start, strict=False)
    average: KNet = copy.deepcopy(network).eval()
    encoder = [p for part in (network.stem, network.stages) for p in part.parameters()]
    inner = {id(p) for p in encoder}
    others = [p for p in network.parameters() if id(p) not in inner]
    optimizer = torch.optim.AdamW([{"params": encoder, "share": 0.5}, {"params": others, "share": 1.0}], lr=how.rate)
    first = 0
    if checkpoint.exists():
        first = restore_checkpoint(checkpoint, network, average, optimizer, how.network.to_dict())
    for part in (network, average):
        part.to(device=device, memory_format=torch.channels_last)
    network.train()
    sums: dict[str, float] = {}
    summed = 0
    samples = _Samples(photographs, chosen, weights, partner, how)
    if first >= (how.steps if until is None else until):
        return average
    for step, batch in enumerate(_batches(samples, how, first), start=first):
        crops, points, visible, azimuth = (b.to(device) for b in batch)
        crops = crops.permute(0, 3, 1, 2).float()
        for group in optimizer.param_groups:
            group["lr"] = how.rate_at(step) * group["share"]
        with torch.autocast(device, dtype=torch.bfloat16, enabled=device != "cpu"):
            output = network(crops)
        losses = knet_loss(output, points, visible, azimuth, how.sigma)
        optimizer.zero_grad(set_to_none=True)
        losses["total"].backward()
        torch.nn.utils.clip_grad_norm_(network.parameters(), _CLIP)
        optimizer.step()
        follow(average, network, min(how.average, (step + 1) / (step + 10)))
        summed += 1
        for name, value in losses.items():
            sums[name] = sums.get(name, 0.0) + float(value.detach())
        ending = step + 1 >= (how.steps if until is None else until)
        if (step + 1) % how.save_every == 0 or ending:
            save_checkpoint(checkpoint, network, average, optimizer, step + 1, how.network.to_dict())
            if report is not None:
                means = {name: value / summed for name, value in sums.items()}
                report(
                    TrainingProgress(step + 1, how.steps, means, None if held is None else held.score(average, device))
                )
            sums, summed = {}, 0
        if ending:
            break
    return average


def _batches(samples: _Samples, how: Training, first: int) -> Iterator[Any]:
    import cv2

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
