"""How far a camera may be astray: what each of its motions leaves unknown adds up along its way."""

from __future__ import annotations

import gtsam
import numpy as np
from numpy.typing import NDArray

__all__ = ["CameraWay"]

Array = NDArray[np.float64]

_ASTRAY = 1e9  # square metres: of a way that is less sure nothing is left of what came last


class CameraWay:
    """How far the camera may be astray from its first place: what its motions leave unknown adds up.

    Attributes:
        covariance: (6, 6) of its way so far, in the axes of the first place.
    """

    def __init__(self) -> None:
        """Begin without a place."""
        self._first: gtsam.Pose3 | None = None
        self.covariance = np.zeros((6, 6))

    def go(self, place: gtsam.Pose3 | None, covariance: Array | None) -> None:
        """Go on to a place, by a motion of this covariance in the axes there."""
        if place is None:
            return
        self._first = self._first or place
        if covariance is not None:
            by_motion = self._first.between(place).AdjointMap()
            with np.errstate(all="ignore"):
                self.covariance = self.covariance + by_motion @ covariance @ by_motion.T

    def since(self, before: Array, place: gtsam.Pose3) -> Array | None:
        """(6, 6) covariance of the way since it was `before`, in the axes of a place; None where rounding hides it."""
        if self._first is None or not np.abs(self.covariance).max() < _ASTRAY:
            return None
        here = place.between(self._first).AdjointMap()
        return np.asarray(here @ (self.covariance - before) @ here.T)
