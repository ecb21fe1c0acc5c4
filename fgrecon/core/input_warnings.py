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

__all__ = ["InputWarning", "InputWarnings", "fits_poorly", "input_warning_of"]

_NAMED = 3  # vehicles that a warning names
_WIDER = 0.25  # of a box's longer side: so far beside it are keypoints still its vehicle's
_FARTHER = 0.5  # of an image's size: so far beyond its edges may those be of a vehicle that they cut off
_EDGE = 0.02  # of an image's size: so near its edge ends the box of a vehicle that it cuts off
_ENOUGH = 6  # keypoints from which on something can be said of their fit
_FIT = 0.5  # weight from which one fits
_FEW = 0.25  # of a vehicle's keypoints

_Array = NDArray[np.float64]


class InputWarning(StrEnum):
    """What is doubtful of a vehicle's keypoints."""

    UNITS = "units"
    BESIDE = "beside"
    BEYOND = "beyond"
    FIT = "fit"

    @property
    def sentence(self) -> str:
        """What to say of the vehicles that it names at `{}`."""
        return _SENTENCES[self.value]


_SENTENCES = {
    "units": "All keypoints of {} lie between 0 and 1, as parts of an image do. Give pixels.",
    "beside": "Most keypoints of {} lie beside the 2D box. Are u and v swapped, or is the box not x1, y1, x2, y2?",
    "beyond": "Most keypoints of {} lie far outside of the image. Are u and v swapped, or is it another image?",
    "fit": "Hardly a keypoint of {} fits. Is their order the category's, and are left and right the vehicle's own?",
}


@dataclass
class InputWarnings:
    """What is doubtful of any number of vehicles; keeps the first names and counts.

    Attributes:
        judged: Vehicles whose fit could be judged.
        counts: Vehicles by what is doubtful.
        names: The first of these.
    """

    judged: int = 0
    counts: Counter[InputWarning] = field(default_factory=Counter)
    names: dict[InputWarning, list[str]] = field(default_factory=dict)

    def add(self, name: str, warning: InputWarning | None) -> None:
        """Count a vehicle."""
        if warning is not None:
            self.counts[warning] += 1
            first = self.names.setdefault(warning, [])
            if len(first) < _NAMED:
                first.append(name)

    def add_fit(self, name: str, *, poorly: bool | None) -> None:
        """Count how a vehicle fits, as `fits_poorly` says."""
        self.judged += poorly is not None
        self.add(name, InputWarning.FIT if poorly else None)

    def lines(self) -> list[str]:
        """What to warn of; of the fit where nothing else is doubtful, and if it is that of most vehicles."""
        kinds: list[InputWarning] = [
            kind for kind in InputWarning if self.counts[kind] and kind is not InputWarning.FIT
        ]
        if not kinds and 2 * self.counts[InputWarning.FIT] > self.judged:
            kinds = [InputWarning.FIT]
        return [kind.sentence.format(self._vehicles(kind)) for kind in kinds]

    def _vehicles(self, kind: InputWarning) -> str:
        more = self.counts[kind] - len(self.names[kind])
        return ", ".join(self.names[kind]) + (f" and {more} more" if more else "")


def input_warning_of(observation: Observation, camera: Camera) -> InputWarning | None:
    """What must be wrong with a vehicle's keypoints, if anything, before it is solved."""
    if not observation.measured.any():
        return None
    every = observation.keypoints[observation.measured]
    if (camera.matrix[:2, 2] > 1.0).any() and ((every >= 0.0) & (every <= 1.0)).all():
        return InputWarning.UNITS
    points = observation.keypoints[_certain(observation)]
    size = None if camera.image_size is None else np.array(camera.image_size, dtype=np.float64)
    if observation.box is not None:
        wider = _WIDER * observation.extent
        beside = _outside(points, observation.box[:2] - wider, observation.box[2:] + wider)
        if size is not None and _at_edge(observation.box, size):  # the vehicle goes on outside of the image
            beside &= ~_outside(points, np.zeros(2), size)
        if np.mean(beside) > 0.5:
            return InputWarning.BESIDE
    if size is not None and np.mean(_outside(points, -_FARTHER * size, (1.0 + _FARTHER) * size)) > 0.5:
        return InputWarning.BEYOND
    return None


def fits_poorly(observation: Observation, weights: _Array) -> bool | None:
    """Whether hardly a keypoint fits; None where they are too few to say.

    Args:
        observation: What was observed.
        weights: (K,) of the result.
    """
    certain = _certain(observation)
    if np.count_nonzero(certain) < _ENOUGH:
        return None
    return bool(np.mean(weights[certain] >= _FIT) < _FEW)


def _at_edge(box: _Array, size: _Array) -> bool:
    """Whether a box reaches an edge of its image."""
    margin = _EDGE * size
    return bool((box[:2] < margin).any() or (box[2:] > size - margin).any())


def _certain(observation: Observation) -> NDArray[np.bool_]:
    """(K,) the keypoints that are as likely right as wrong, or likelier; all that are measured where none is."""
    certain: NDArray[np.bool_] = observation.measured & (observation.confidence >= observation.confidence_midpoint)
    return certain if certain.any() else observation.measured


def _outside(points: _Array, least: _Array, most: _Array) -> NDArray[np.bool_]:
    """(N,) which points (N, 2) lie outside of a rectangle."""
    outside: NDArray[np.bool_] = np.any((points < least) | (points > most), axis=1)
    return outside
