"""Sources of training samples: views of cars by number, of one source or of several."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.arrays import Array
from fgrecon.core.metrics import wrap_angle
from fgrecon_research.training.keypoints.augment import Sample, Street
from fgrecon_research.training.keypoints.deform import LabelledView, Partner

_BINS = 36
_TRIES = 12


class Views(ABC):
    """Labelled views of cars by number, read on use."""

    azimuth: Array
    """(M,) direction from the car to the camera, radians."""

    @abstractmethod
    def view(self, index: int) -> LabelledView:
        """One of them."""

    def draw(
        self, chosen: NDArray[np.intp], weights: Array, street: Street, partner: Partner, seed: Sequence[int]
    ) -> Sample:
        """A sample, fully determined by the seed: a view drawn by weight, and what else is in the picture likewise."""
        rng = np.random.default_rng(list(seed))
        index = int(rng.choice(chosen, p=weights))

        def another(azimuth: float | None) -> LabelledView:
            some = rng.choice(chosen, _TRIES, p=weights)
            if azimuth is None:
                view = self.view(int(some[0]))
                return view.mirrored(partner) if rng.random() < 0.5 else view
            # Of a handful the one most alike; the mirror image of a view from the other side will do as well.
            away = np.abs(np.abs(wrap_angle(self.azimuth[some])) - abs(wrap_angle(azimuth)))
            view = self.view(int(some[away.argmin()]))
            return view if view.azimuth * azimuth > 0 else view.mirrored(partner)

        return street.sample(self.view(index), another, partner, rng)


class Together(Views):
    """Several sources one after the other."""

    def __init__(self, parts: Sequence[Views]) -> None:
        """Number them through."""
        self.parts = tuple(parts)
        self.starts = np.cumsum([0, *(len(part.azimuth) for part in parts)])
        self.azimuth = np.concatenate([part.azimuth for part in parts])

    def view(self, index: int) -> LabelledView:
        """One of them."""
        part = int(np.searchsorted(self.starts, index, side="right")) - 1
        return self.parts[part].view(index - int(self.starts[part]))


@dataclass(frozen=True, eq=False)
class TrainingSet:
    """What is learnt from."""

    views: Views
    chosen: NDArray[np.intp]  # (N,) which of them
    weights: Array  # (N,) probability of drawing each

    def draw(self, street: Street, partner: Partner, seed: Sequence[int]) -> Sample:
        """A sample, fully determined by the seed."""
        return self.views.draw(self.chosen, self.weights, street, partner, seed)


def azimuth_weights(azimuth: Array, chosen: NDArray[np.intp], strength: float = 1.0, limit: float = 12.0) -> Array:
    """Probabilities with which to draw views so that all directions come up about equally often.

    Mirroring makes directions to the left and right alike, so only the angle from the front counts.

    Args:
        azimuth: (M,) radians.
        strength: 0 leaves the views as they are, 1 evens out fully.
        limit: How much more often than the most frequent direction a rare one's views may be drawn.
    """
    angle = np.abs(wrap_angle(azimuth[chosen]))
    which = np.minimum((angle / np.pi * _BINS / 2).astype(int), _BINS // 2 - 1)
    count = np.bincount(which, minlength=_BINS // 2).astype(np.float64)
    smooth = np.convolve(np.pad(count, 1, mode="edge"), [0.25, 0.5, 0.25], mode="valid")
    weight = np.minimum((smooth.max() / np.maximum(smooth, 1e-9)) ** strength, limit)[which]
    return weight / weight.sum()
