"""A depth map in metres, and the variables of the errors that all its pixels share.

    z' = exp(a) z + b,    or    1 / z' = exp(a) / z + b    of an inverse depth

for the depth z of a pixel by what is known of scale and shift; the vehicles of the image share (a, b), which are about
0 by as much as scale and shift are sure (`factors.surface_points`).
"""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from factors.surface_points import Shared
from fgrecon.core.arrays import Array
from fgrecon.core.depth_map import DepthCalibration, DepthMap
from fgrecon.solve.proposals.search_settings import SETTINGS


@dataclass(frozen=True, eq=False)
class ScaledDepth:
    """A depth map whose scale and shift are about known."""

    given: DepthMap
    calibration: DepthCalibration  # about what its numbers are
    shared: Shared  # what the variables are
    covariance: Array  # (2, 2) of the variables

    @property
    def key(self) -> Hashable:
        """The same for all pixels of the map."""
        return self.given.sensor or id(self.given)

    def metres(self, row: NDArray[np.intp], column: NDArray[np.intp]) -> Array:
        """(M,) depths of pixels, metres; NaN where there is none."""
        return self.given.metres(self.given.at(row, column), self.calibration)

    def calibrated(self, variables: Array, covariance: Array) -> tuple[float, float, Array]:
        """Scale and shift by the variables (2,), and by their covariance (2, 2) theirs; of metric depths as inverse."""
        scale, before = float(np.exp(variables[0])), self.calibration
        shift = scale * before.shift + float(variables[1])
        if self.shared is Shared.INVERSE and not self.given.inverse:
            shift, by = float(variables[1]), np.array([[before.scale * scale, 0.0], [0.0, 1.0]])
        else:
            by = np.array([[before.scale * scale, 0.0], [before.shift * scale, 1.0]])
        if self.shared is Shared.INVERSE:
            shift, by[1, 0] = shift + scale * self.given.shared_mean, by[1, 0] + scale * self.given.shared_mean
        return before.scale * scale, shift, by @ covariance @ by.T


@lru_cache(maxsize=4)  # the vehicles of an image follow each other; maps are large
def scaled_depth(given: DepthMap) -> ScaledDepth:
    """A map whose calibration is known, or was found."""
    calibration = given.known
    assert calibration is not None
    by = np.array([[calibration.scale, 0.0], [calibration.shift, 1.0]])
    inverse = np.linalg.inv(by)
    covariance = inverse @ np.asarray(calibration.covariance) @ inverse.T
    if given.shared_sigma and (given.inverse or not covariance.any()):
        covariance = covariance + np.diag([0.0, given.shared_sigma**2])
        shared = Shared.INVERSE
    else:
        shared = Shared.NONE if not covariance.any() else Shared.INVERSE if given.inverse else Shared.DEPTH
    return ScaledDepth(given, calibration, shared, covariance + SETTINGS.points.known_variable_sigma**2 * np.eye(2))
