"""Noise models of factors, from checked covariances and standard deviations."""

from __future__ import annotations

import gtsam
import numpy as np
from numpy.typing import ArrayLike

from factors.checks import finite_array
from factors.errors import InvalidInputError

Noise = gtsam.noiseModel.Base | float
"""A noise model, or one sigma for every row of the residual, in the residual's unit."""

_ROUNDING = 1e-9  # share of the largest number of a matrix by which it may be off symmetry


def full_noise(field: str, covariance: ArrayLike) -> gtsam.noiseModel.Gaussian:
    """Noise model with one covariance (N, N) for all rows.

    Raises:
        InvalidInputError: It is not symmetric positive definite (GTSAM would divide by zero).
    """
    matrix = finite_array(field, covariance, (None, None))
    try:
        np.linalg.cholesky(matrix)
        off = np.abs(matrix - matrix.T).max(initial=0.0)  # J S J' is symmetric but for rounding
        alike = matrix.size > 0 and bool(off <= _ROUNDING * np.abs(matrix).max())
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
    sigma = float(noise)
    if not (np.isfinite(sigma) and sigma > 0):
        raise InvalidInputError(f"{field}.noise", noise, "Give a positive number.")
    return gtsam.noiseModel.Isotropic.Sigma(rows, sigma)
