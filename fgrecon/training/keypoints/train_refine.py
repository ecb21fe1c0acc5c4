"""Training of the refinement networks: patches around the labels, off by as much as KNet's estimates are."""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from fgrecon.perception.keypoints.crops import MARGIN
from fgrecon.perception.keypoints.refine import PATCH, RefineNet, RefineSettings, cut_patches
from fgrecon.training.keypoints.augment import Street
from fgrecon.training.keypoints.checkpoint import follow, restore_checkpoint, save_checkpoint
from fgrecon.training.keypoints.dataset import Photographs
from fgrecon.training.keypoints.losses import HIDDEN_WEIGHT, map_loss
from fgrecon.training.keypoints.train import TrainingProgress

__all__ = ["RefineTraining", "train_refinement"]

Array = NDArray[np.float64]

_SEED = 7_000_000  # keeps the samples apart from KNet's


@dataclass(frozen=True)
class RefineTraining:
    """How the refinement networks are trained.

    Attributes:
        steps: Gradient steps in all.
        decay: Share of them in which the rate falls to zero.
        batch: Samples per step, each with a patch for every keypoint.
        rate: Learning rate.
        sigma: Standard deviation of the target Gaussians, pixels of the patch.
        estimate: Standard deviation of KNet's estimate around the label, as a fraction of the car's longer side.
        average: Decay per step of the moving average of the weights.
        seed: Of samples and first weights.
        save_every: Steps between checkpoints.
        network: Sizes.
        street: Augmentation; without much occlusion, since hidden points teach little.
    """

    steps: int = 2000
    decay: float = 0.3
    batch: int = 16
    rate: float = 2e-3
    sigma: float = 2.2
    estimate: float = 0.035
    average: float = 0.995
    seed: int = 0
    save_every: int = 50
    network: RefineSettings = field(default_factory=RefineSettings)
    street: Street = field(default_factory=lambda: replace(Street(), covered=0.15, block=0.1, truncated=0.06))

    def rate_at(self, step: int) -> float:
        """Learning rate of a step: level, then down to zero."""
        start = round(self.steps * (1.0 - self.decay))
        return self.rate * (1.0 if step < start else max(self.steps - step, 0) / max(self.steps - start, 1))


def train_refinement(
    photographs: Photographs,
    chosen: NDArray[np.intp],
    weights: Array,
    partner: NDArray[np.intp],
    checkpoint: Path,
    how: RefineTraining,
    *,
    start: Mapping[str, Any] | None = None,
    device: str = "cpu",
    report: Callable[[TrainingProgress], None] | None = None,
) -> RefineNet:
    """Train, or go on where the checkpoint ends.

    Args:
        photographs: Prepared photographs with labels.
        chosen: Which of them to learn from.
        weights: How often to draw each.
        partner: (K,) index of each keypoint's mirror image.
        checkpoint: File to go on from and to write to.
        how: Settings.
        start: Weights to start from, without a checkpoint.
        device: Torch's name of the device.
        report: Called after every `save_every` steps.

    Returns:
        The averaged networks, in evaluation mode.
    """
    torch.manual_seed(how.seed)
    network: RefineNet = RefineNet(how.network)
    if start is not None:
        network.load_state_dict(start, strict=False)
    network = network.to(device)
    average: RefineNet = copy.deepcopy(network)
    optimizer = torch.optim.AdamW(network.parameters(), lr=how.rate)
    first = 0
    if checkpoint.exists():
        first = restore_checkpoint(checkpoint, network, average, optimizer, how.network.to_dict())
    network.train()
    street, sums, summed = replace(how.street, size=how.network.crop), 0.0, 0
    for step in range(first, how.steps):
        drawn = [
            photographs.draw(chosen, weights, street, partner, (how.seed, _SEED + step * how.batch + i))
            for i in range(how.batch)
        ]
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
        tensors = [torch.from_numpy(np.ascontiguousarray(a)).to(device).float() for a in (patches, inside, weight)]
        for group in optimizer.param_groups:
            group["lr"] = how.rate_at(step)
        loss = map_loss(network(tensors[0]), tensors[1], tensors[2], 1.0, how.sigma)
        optimizer.zero_grad(set_to_none=True)
        loss.backward()
        optimizer.step()
        follow(average, network, min(how.average, (step + 1) / (step + 10)))
        sums, summed = sums + float(loss.detach()), summed + 1
        if (step + 1) % how.save_every == 0 or step + 1 == how.steps:
            save_checkpoint(checkpoint, network, average, optimizer, step + 1, how.network.to_dict())
            if report is not None:
                report(TrainingProgress(step + 1, how.steps, {"patches": sums / summed}))
            sums, summed = 0.0, 0
    average.eval()
    return average
