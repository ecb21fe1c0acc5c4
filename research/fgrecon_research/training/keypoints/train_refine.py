"""The refinement networks, and their training: patches around labels, off by as much as KNet's estimates are."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional

from fgrecon.core.arrays import Array
from fgrecon.perception.keypoints.crops import MARGIN, cut_patches
from fgrecon.perception.keypoints.layout import MEAN, PATCH, SPREAD, Layer, RefineLayout, RefineSettings
from fgrecon_research.training.keypoints.augment import Sample, Street
from fgrecon_research.training.keypoints.deform import Partner
from fgrecon_research.training.keypoints.losses import HIDDEN_WEIGHT, map_loss
from fgrecon_research.training.keypoints.trainer import Schedule, Trainer, TrainingProgress
from fgrecon_research.training.keypoints.views import TrainingSet


class _Grouped(nn.Module):  # type: ignore[misc]
    """Convolution in K groups, batch normalisation, ReLU."""

    def __init__(self, layer: Layer) -> None:
        super().__init__()
        self.conv = nn.Conv2d(
            *(layer.inputs, layer.outputs, layer.kernel, layer.stride, layer.padding[0]),
            dilation=layer.dilation,
            groups=layer.groups,
            bias=False,
        )
        self.norm = nn.BatchNorm2d(layer.outputs, eps=layer.epsilon)

    def forward(self, x: Tensor) -> Tensor:
        return functional.relu(self.norm(self.conv(x)), inplace=True)


class RefineNet(nn.Module):  # type: ignore[misc]
    """K small networks side by side: a convolution with K groups."""

    def __init__(self, settings: RefineSettings | None = None) -> None:
        """Build with random weights."""
        super().__init__()
        self.settings = settings = RefineSettings() if settings is None else settings
        layout = RefineLayout.of(settings)
        self.layers = nn.Sequential(*(_Grouped(layer) for layer in layout.layers))
        self.head = nn.Conv2d(layout.head.inputs, layout.head.outputs, 1, groups=layout.head.groups)

    def forward(self, patches: Tensor) -> Tensor:
        """Logits (M, K, 32, 32) over patches (M, K, 3, 32, 32) of RGB values from 0 to 255."""
        x = ((patches - MEAN) / SPREAD).flatten(1, 2)
        return functional.pixel_shuffle(self.head(self.layers(x)), 2)


_SEED = 7_000_000  # keeps the samples apart from KNet's


@dataclass(frozen=True)
class RefineTraining(Schedule):
    """How the refinement networks are trained: see `Schedule`; each sample has a patch for every keypoint."""

    steps: int = 2000
    decay: float = 0.3
    batch: int = 16
    rate: float = 2e-3
    warmup: int = 0
    average: float = 0.995
    save_every: int = 50
    sigma: float = 2.2  # standard deviation of the target Gaussians, pixels of the patch
    # standard deviation of KNet's estimate around the label, as a fraction of the car's longer side
    estimate: float = 0.035
    network: RefineSettings = field(default_factory=RefineSettings)  # sizes
    # augmentation; without much occlusion, since hidden points teach little
    street: Street = field(default_factory=lambda: replace(Street(), covered=0.15, block=0.1, truncated=0.06))


def train_refinement(
    learning: TrainingSet,
    partner: Partner,
    checkpoint: Path,
    how: RefineTraining,
    *,
    start: Mapping[str, Any] | None = None,
    report: Callable[[TrainingProgress], None] | None = None,
) -> RefineNet:
    """Train, or go on where the checkpoint ends.

    Args:
        start: Weights to start from, without a checkpoint.

    Returns:
        The averaged networks, in evaluation mode.
    """
    torch.manual_seed(how.seed)
    network: RefineNet = RefineNet(how.network)
    if start is not None:
        network.load_state_dict(start, strict=False)
    network = network.to(how.device)
    trainer = Trainer(network, [{"params": network.parameters()}], how, checkpoint, how.network.to_dict(), report)

    def losses(drawn: tuple[int, list[Sample]]) -> dict[str, Any]:
        patches, inside, weight = (torch.from_numpy(a).to(how.device).float() for a in _targets(*drawn, how))
        return {"patches": map_loss(network(patches), inside, weight, 1.0, how.sigma)}

    street = replace(how.street, size=how.network.crop)
    samples = (
        (
            step,
            [learning.draw(street, partner, (how.seed, _SEED + step * how.batch + i)) for i in range(how.batch)],
        )
        for step in range(trainer.done, how.steps)
    )
    return trainer.run(samples, losses, objective="patches")


def _targets(step: int, drawn: Sequence[Sample], how: RefineTraining) -> tuple[NDArray[np.uint8], Array, Array]:
    """Patches around estimates of the keypoints, the labels in pixels of the patches, and how much each point counts.

    The patches are (B, K, 3, P, P), the labels (B, K, 2), the weights (B, K): 0 where the label is unknown or not in
    the patch.
    """
    rng = np.random.default_rng((how.seed, _SEED, step))
    points = np.array([sample.keypoints for sample in drawn])
    known = np.isfinite(points).all(axis=-1)
    points = np.where(known[..., None], points, 0.0)
    estimate = points + rng.normal(0.0, how.estimate * how.network.crop / MARGIN, points.shape)
    corners = np.rint(estimate).astype(np.int64)[:, None] - PATCH // 2
    patches = cut_patches(np.stack([sample.crop for sample in drawn]), corners)[:, 0]
    inside = points - corners[:, 0]
    there = ((inside >= 0) & (inside <= PATCH - 1)).all(axis=-1)
    visible = np.array([sample.visible for sample in drawn])
    weight = (HIDDEN_WEIGHT * 0.4 + (1.0 - HIDDEN_WEIGHT * 0.4) * visible) * (there & known)
    return np.ascontiguousarray(patches), inside.astype(np.float64), weight
