"""How far a camera may be astray: what each of its motions leaves unknown adds up along its way."""

from __future__ import annotations

from dataclasses import dataclass, field

import gtsam
import numpy as np
from numpy.typing import NDArray

__all__ = ["CameraWay", "Milestone"]

Array = NDArray[np.float64]

_ASTRAY = 1e9  # square metres: of a way that is less sure rounding hides what comes next


@dataclass(frozen=True, eq=False)
class Milestone:
    """A place on a camera's way.

    Attributes:
        begun: Where the way begins on which it is.
        covariance: (6, 6) of the way from there, in the axes of its beginning.
    """

    begun: gtsam.Pose3 | None = None
    covariance: Array = field(default_factory=lambda: np.zeros((6, 6)))


class CameraWay:
    """How far the camera may be astray from the beginning of its way: what its motions leave unknown adds up.

    A way that is too unsure begins anew: nothing is known of how what was before lies to what comes then.

    Attributes:
        here: Where the camera is.
    """

    def __init__(self) -> None:
        """Begin without a place."""
        self.here = Milestone()

    def go(self, place: gtsam.Pose3 | None, covariance: Array | None) -> None:
        """Go on to a place, by a motion of this covariance in the axes there."""
        if place is None:
            return
        begun = self.here.begun or place
        total = self.here.covariance
        if covariance is not None:
            by_motion = begun.between(place).AdjointMap()
            with np.errstate(all="ignore"):
                total = total + by_motion @ covariance @ by_motion.T
        self.here = Milestone(begun, total) if np.abs(total).max() < _ASTRAY else Milestone(place)

    def since(self, before: Milestone, place: gtsam.Pose3) -> Array | None:
        """(6, 6) covariance of the way since a milestone, in the axes of a place; None where nothing is known of it."""
        begun = self.here.begun
        if begun is None or before.begun is not begun:
            return None
        here = place.between(begun).AdjointMap()
        return _rounded(here @ (self.here.covariance - before.covariance) @ here.T)


def _rounded(covariance: Array) -> Array:
    """The covariance that was meant: a small difference of large sums is neither symmetric nor positive to the last."""
    spread, axes = np.linalg.eigh((covariance + covariance.T) / 2.0)
    return np.asarray((axes * np.maximum(spread, 0.0)) @ axes.T)
