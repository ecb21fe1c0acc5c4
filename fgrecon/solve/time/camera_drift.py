"""Drift of the camera's pose: the uncertainty of its motions, summed along its way."""

from __future__ import annotations

from dataclasses import dataclass, field

import gtsam
import numpy as np

from fgrecon.core.arrays import Array
from fgrecon.solve.time.time_settings import SETTINGS


@dataclass(frozen=True, eq=False)
class CameraDrift:
    """How far a camera may be astray since the beginning of its way.

    A way that is too unsure begins anew: nothing is known of how what was before is placed to what comes then.
    """

    begun: gtsam.Pose3 | None = None  # where the way begins; None where the camera had no place yet
    # (6, 6) of the way from there, in the axes of its beginning
    covariance: Array = field(default_factory=lambda: np.zeros((6, 6)))

    def moved(self, place: gtsam.Pose3 | None, covariance: Array | None) -> CameraDrift:
        """The drift at a place, after a motion of this covariance (6, 6) in the axes there; None where it is exact."""
        if place is None:
            return self
        begun, total = self.begun or place, self.covariance
        if covariance is not None:
            by_motion = begun.between(place).AdjointMap()
            with np.errstate(all="ignore"):
                total = total + by_motion @ covariance @ by_motion.T
        return CameraDrift(begun, total) if np.abs(total).max() < SETTINGS.camera_drift_m2 else CameraDrift(place)

    def since(self, before: CameraDrift, place: gtsam.Pose3) -> Array | None:
        """(6, 6) covariance of the way since then, in the axes of a place; None where nothing is known of it."""
        if self.begun is None or before.begun is not self.begun:
            return None
        here = place.between(self.begun).AdjointMap()
        covariance = here @ (self.covariance - before.covariance) @ here.T
        # A small difference of large sums is neither symmetric nor positive to the last digit.
        spread, axes = np.linalg.eigh((covariance + covariance.T) / 2.0)
        return np.asarray((axes * np.maximum(spread, 0.0)) @ axes.T)
