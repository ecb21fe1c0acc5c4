"""Keypoints that are surely not what they are taken for: of one vehicle what must be wrong, of many what to warn of.

Such keypoints are solved nevertheless, since each of these can be right in an odd case; but the status of a result
alone does not tell what to look for.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.camera import Camera
from fgrecon.core.observation import Observation

__all__ = ["Doubt", "Doubts", "doubt_of", "hardly_fits"]

_NAMED = 3  # vehicles that a warning names
_WIDER = 0.25  # of a box's longer side: so far beside it are keypoints still its vehicle's
_FARTHER = 0.5  # of an image's size: so far beyond its edges may those be of a vehicle that they cut off
_EDGE = 0.02  # of an image's size: so near its edge ends the box of a vehicle that it cuts off
_ENOUGH = 6  # keypoints from which on something can be said of their fit
_FIT = 0.5  # weight from which one fits
_FEW = 0.25  # of a vehicle's keypoints

_Array = NDArray[np.float64]


class Doubt(StrEnum):
    """What is doubtful of a vehicle's keypoints."""

    UNITS = "units"
    """All lie between 0 and 1."""
    BESIDE = "beside"
    """Most lie beside the 2D box."""
    BEYOND = "beyond"
    """Most lie far outside of the image."""
    FIT = "fit"
    """Hardly one fits the result."""


_WORDS = {
    Doubt.UNITS: "All keypoints of {} lie between 0 and 1, as parts of an image do. Give pixels.",
    Doubt.BESIDE: "Most keypoints of {} lie beside the 2D box. Are u and v swapped, or is the box not x1, y1, x2, y2?",
    Doubt.BEYOND: "Most keypoints of {} lie far outside of the image. Are u and v swapped, or is it another image?",
    Doubt.FIT: "Hardly a keypoint of {} fits. Is their order the category's, and are left and right the vehicle's own?",
}


@dataclass
class Doubts:
    """What is doubtful of any number of vehicles; keeps the first names and counts.

    Attributes:
        judged: Vehicles whose fit could be judged.
        counts: Vehicles by what is doubtful.
        names: The first of these.
    """

    judged: int = 0
    counts: Counter[Doubt] = field(default_factory=Counter)
    names: dict[Doubt, list[str]] = field(default_factory=dict)

    def add(self, name: str, doubt: Doubt | None) -> None:
        """Count a vehicle."""
        if doubt is not None:
            self.counts[doubt] += 1
            first = self.names.setdefault(doubt, [])
            if len(first) < _NAMED:
                first.append(name)

    def add_fit(self, name: str, *, hardly: bool | None) -> None:
        """Count how a vehicle fits, as `hardly_fits` says."""
        self.judged += hardly is not None
        self.add(name, Doubt.FIT if hardly else None)

    def lines(self) -> list[str]:
        """What to warn of; of the fit where nothing else is doubtful, and if it is that of most vehicles."""
        told: list[Doubt] = [doubt for doubt in Doubt if self.counts[doubt] and doubt is not Doubt.FIT]
        if not told and 2 * self.counts[Doubt.FIT] > self.judged:
            told.append(Doubt.FIT)
        return [_WORDS[doubt].format(self._told(doubt)) for doubt in told]

    def _told(self, doubt: Doubt) -> str:
        more = self.counts[doubt] - len(self.names[doubt])
        return ", ".join(self.names[doubt]) + (f" and {more} more" if more else "")


def doubt_of(seen: Observation, camera: Camera) -> Doubt | None:
    """What must be wrong with a vehicle's keypoints, if anything, before it is solved."""
    if not seen.measured.any():
        return None
    every = seen.keypoints[seen.measured]
    if (camera.matrix[:2, 2] > 1.0).any() and ((every >= 0.0) & (every <= 1.0)).all():
        return Doubt.UNITS
    points = seen.keypoints[_certain(seen)]
    size = None if camera.image_size is None else np.array(camera.image_size, dtype=np.float64)
    if seen.box is not None:
        wider = _WIDER * seen.extent
        beside = _outside(points, seen.box[:2] - wider, seen.box[2:] + wider)
        if size is not None and _at_edge(seen.box, size):  # the vehicle goes on outside of the image
            beside &= ~_outside(points, np.zeros(2), size)
        if np.mean(beside) > 0.5:
            return Doubt.BESIDE
    if size is not None and np.mean(_outside(points, -_FARTHER * size, (1.0 + _FARTHER) * size)) > 0.5:
        return Doubt.BEYOND
    return None


def hardly_fits(seen: Observation, weights: _Array) -> bool | None:
    """Whether hardly a keypoint fits; None where they are too few to say.

    Args:
        seen: What was observed.
        weights: (K,) of the result.
    """
    certain = _certain(seen)
    if np.count_nonzero(certain) < _ENOUGH:
        return None
    return bool(np.mean(weights[certain] >= _FIT) < _FEW)


def _at_edge(box: _Array, size: _Array) -> bool:
    """Whether a box reaches an edge of its image."""
    margin = _EDGE * size
    return bool((box[:2] < margin).any() or (box[2:] > size - margin).any())


def _certain(seen: Observation) -> NDArray[np.bool_]:
    """(K,) the keypoints that are as likely right as wrong, or likelier; all that are measured where none is."""
    certain: NDArray[np.bool_] = seen.measured & (seen.confidence >= seen.confidence_midpoint)
    return certain if certain.any() else seen.measured


def _outside(points: _Array, least: _Array, most: _Array) -> NDArray[np.bool_]:
    """(N,) which points (N, 2) lie outside of a rectangle."""
    outside: NDArray[np.bool_] = np.any((points < least) | (points > most), axis=1)
    return outside
