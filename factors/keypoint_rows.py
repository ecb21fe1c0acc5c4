"""Reprojection residuals of keypoints, whitened: E_reproj of the paper's section III-C.

    r_i = W_i (pi(K (R X_i(lambda, offsets) + t)) - x_i),    W_i' W_i = Sigma_i^-1

The rows of a factor (`factors.observation_rows`), and for many poses at once those of the search.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from factors.arrays import Array
from factors.checks import finite_array
from factors.errors import InvalidInputError

SMALLEST_WEIGHT = 1e-12
"""A keypoint of less weight is left out."""


@dataclass(frozen=True)
class KeypointRows:
    """Measured keypoints.

    Attributes:
        pixels: (K, 2) where they were measured, without lens distortion; any finite number where they were not.
        whitener: (K, 3) entries a, b, c of lower triangular whiteners [[a, 0], [b, c]].
    """

    pixels: Array
    whitener: Array

    def residual(self, projected: Array) -> Array:
        """Whitened residuals (..., K, 2) of projected pixels (..., K, 2)."""
        return self.whiten((projected - self.pixels)[..., None])[..., 0]

    def whiten(self, pairs: Array) -> Array:
        """Pairs of rows (..., K, 2, D) times the whiteners."""
        a, b, c = self.whitener.T[..., None]
        u, v = pairs[..., 0, :], pairs[..., 1, :]
        return np.stack([a * u, b * u + c * v], axis=-2)


def whiteners(covariances: ArrayLike) -> Array:
    """(K, 3) inverse Cholesky factors [[a, 0], [b, c]] of covariances (K, 2, 2) in square pixels.

    Raises:
        InvalidInputError: A covariance is not symmetric positive definite.
    """
    S = finite_array("covariances", covariances, (None, 2, 2))
    try:
        inverse = np.linalg.inv(np.linalg.cholesky(S)).reshape(-1, 4)
    except np.linalg.LinAlgError as error:
        fix = "Give symmetric positive definite matrices."
        raise InvalidInputError("covariances", S.tolist(), fix) from error
    return np.ascontiguousarray(inverse[:, [0, 2, 3]])
