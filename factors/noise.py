"""Noise models: IRLS weights, detector covariances and robust losses.

A weight w_i of iteratively re-weighted least squares enters a factor as its standard deviation,

    sigma_i = sigma_0 / sqrt(w_i),    or    Sigma_i / w_i

where a detector gives a keypoint's own 2x2 covariance: the factor's energy ||r_i / sigma_i||^2 is then w_i times that
of an unweighted one. It may act alone or inside a robust loss, which then weighs the whitened norm. A weight of zero
means no factor at all.
"""

from __future__ import annotations

import gtsam
import numpy as np
from numpy.typing import ArrayLike, NDArray

from factors.checks import finite_array
from factors.errors import InvalidInputError
from factors.losses import RobustLoss

__all__ = [
    "SMALLEST_WEIGHT",
    "Noise",
    "as_noise",
    "diagonal_noise",
    "full_noise",
    "keypoint_noise",
    "keypoint_whiteners",
]

Noise = gtsam.noiseModel.Base | float
"""A noise model, or one sigma for every row of the residual, in the residual's unit."""

_ROUNDING = 1e-9  # share of the largest number of a matrix by which it may be off symmetry
SMALLEST_WEIGHT = 1e-12
"""A keypoint of less weight is left out."""


def keypoint_noise(
    weight: float,
    sigma: float,
    *,
    covariance: ArrayLike | None = None,
    robust: RobustLoss | None = None,
) -> gtsam.noiseModel.Base | None:
    """Noise model of one keypoint's reprojection factor.

    Args:
        weight: IRLS weight w_i >= 0.
        sigma: Standard deviation sigma_0 of a keypoint of weight 1, pixels; not used where a covariance is given.
        covariance: (2, 2) covariance of the keypoint, pixels^2, where the detector gives one.
        robust: Robust loss around it, or None.

    Returns:
        The noise model, or None for a weight of zero (the keypoint gets no factor).

    Raises:
        InvalidInputError: The weight is negative or not finite, sigma is not positive, or the covariance is not
            symmetric positive definite.
    """
    if not (np.isfinite(weight) and weight >= 0):
        raise InvalidInputError("weight", weight, "Give a finite weight >= 0.")
    if weight < SMALLEST_WEIGHT:
        return None
    noise: gtsam.noiseModel.Base
    if covariance is None:
        noise = gtsam.noiseModel.Isotropic.Sigma(2, _positive("sigma", sigma) / float(np.sqrt(weight)))
    else:
        matrix = finite_array("covariance", covariance, (2, 2))
        if not _symmetric(matrix) or matrix[0, 0] <= 0 or np.linalg.det(matrix) <= 0:
            raise InvalidInputError("covariance", matrix.tolist(), "Give a symmetric positive definite 2x2 matrix.")
        matrix = (matrix + matrix.T) / 2.0
        noise = gtsam.noiseModel.Gaussian.Covariance(matrix / weight)
    return noise if robust is None else robust.wrap(noise)


def keypoint_whiteners(weights: ArrayLike, sigma: float, covariances: ArrayLike | None = None) -> NDArray[np.float64]:
    """Inverse square roots of Sigma_i / w_i for many keypoints at once.

    Args:
        weights: (K,) IRLS weights w_i >= 0.
        sigma: Standard deviation sigma_0 of a keypoint of weight 1, pixels; not used where covariances are given.
        covariances: (K, 2, 2) covariance of each keypoint, pixels^2, or None.

    Returns:
        (K, 3) entries a, b, c of lower triangular matrices W_i = [[a, 0], [b, c]], W_i' W_i = w_i Sigma_i^-1; zero for
        a keypoint without weight.

    Raises:
        InvalidInputError: A weight is negative or not finite, sigma is not positive, or a covariance is not symmetric
            positive definite.
    """
    array = finite_array("weights", weights, (None,))
    if array.size and array.min() < 0:
        raise InvalidInputError("weights", float(array.min()), "Give weights >= 0.")
    result = np.zeros((len(array), 3))
    if covariances is None:
        result[:, 0] = result[:, 2] = 1.0 / _positive("sigma", sigma)
    else:
        S = finite_array("covariances", covariances, (len(array), 2, 2))
        determinants = S[:, 0, 0] * S[:, 1, 1] - S[:, 0, 1] ** 2
        wrong = ~_symmetric(S) | (S[:, 0, 0] <= 0) | (determinants <= 0)
        if wrong.any():
            raise InvalidInputError("covariances", S[wrong][0].tolist(), "Give symmetric positive definite matrices.")
        # The inverse of the Cholesky factor [[l, 0], [m, n]] with l^2 = S_00, l m = S_01, l n = sqrt(det).
        result[:, 0] = 1.0 / np.sqrt(S[:, 0, 0])
        result[:, 2] = np.sqrt(S[:, 0, 0] / determinants)
        result[:, 1] = -S[:, 0, 1] / S[:, 0, 0] * result[:, 2]
    return result * np.sqrt(np.where(array < SMALLEST_WEIGHT, 0.0, array))[:, None]


def full_noise(field: str, covariance: ArrayLike) -> gtsam.noiseModel.Gaussian:
    """Noise model with one covariance (N, N) for all rows.

    Raises:
        InvalidInputError: It is not symmetric positive definite (GTSAM would divide by zero).
    """
    matrix = finite_array(field, covariance, (None, None))
    try:
        np.linalg.cholesky(matrix)
        alike = matrix.size > 0 and bool(_symmetric(matrix))
    except np.linalg.LinAlgError:
        alike = False
    if not alike:
        raise InvalidInputError(field, matrix.tolist(), "Give a symmetric positive definite matrix.")
    return gtsam.noiseModel.Gaussian.Covariance((matrix + matrix.T) / 2.0)


def diagonal_noise(field: str, sigmas: ArrayLike) -> gtsam.noiseModel.Diagonal:
    """Noise model with one standard deviation per row.

    Raises:
        InvalidInputError: A sigma is not positive and finite (GTSAM would make a hard constraint of zero).
    """
    array = finite_array(field, sigmas, (None,))
    if not len(array) or array.min() <= 0:
        raise InvalidInputError(field, array.tolist(), "Give positive standard deviations.")
    return gtsam.noiseModel.Diagonal.Sigmas(array)


def as_noise(field: str, noise: Noise, rows: int) -> gtsam.noiseModel.Base:
    """A noise model of dimension `rows` from a model or from one sigma.

    Raises:
        InvalidInputError: The model has another dimension, or sigma is not positive and finite.
    """
    if isinstance(noise, gtsam.noiseModel.Base):
        if noise.dim() != rows:
            raise InvalidInputError(f"{field}.noise", f"dimension {noise.dim()}", f"Give a model of dimension {rows}.")
        return noise
    return gtsam.noiseModel.Isotropic.Sigma(rows, _positive(f"{field}.noise", noise))


def _symmetric(matrices: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Whether matrices (..., N, N) are symmetric but for rounding, as J S J' is."""
    off = np.abs(matrices - matrices.swapaxes(-1, -2)).max(axis=(-2, -1))
    alike: NDArray[np.bool_] = off <= _ROUNDING * np.abs(matrices).max(axis=(-2, -1))
    return alike


def _positive(field: str, value: float) -> float:
    number = float(value)
    if not (np.isfinite(number) and number > 0):
        raise InvalidInputError(field, value, "Give a positive number.")
    return number
