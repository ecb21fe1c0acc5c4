"""Gaussian priors on the shape: lambda ~ N(0, I) (the paper's Eq. 1) and offsets ~ N(0, sigma_k^2 I).

Both are linear in one variable, so that GTSAM's own prior factor, which needs no Python callback, does.
"""

from __future__ import annotations

import gtsam
import numpy as np
from numpy.typing import ArrayLike

from factors.checks import finite_array
from factors.errors import InvalidInputError
from factors.noise import diagonal_noise

__all__ = ["coefficients_prior", "offsets_prior"]


def coefficients_prior(coefficients_key: int, dimension: int, sigma: float = 1.0) -> gtsam.PriorFactorVector:
    """Prior on lambda: r = lambda, N rows, in standard deviations.

    Args:
        coefficients_key: Key of lambda.
        dimension: Number of coefficients N >= 1.
        sigma: Standard deviation of each coefficient; 1 where the basis is scaled to unit variance.

    Raises:
        InvalidInputError: The dimension or sigma is not positive.
    """
    if dimension < 1:
        raise InvalidInputError("dimension", dimension, "Give at least one coefficient.")
    return _zero_prior(coefficients_key, np.full(dimension, sigma))


def offsets_prior(offsets_key: int, sigmas: ArrayLike) -> gtsam.PriorFactorVector:
    """Prior on the free offsets: r = offsets, 3K rows, metres.

    Args:
        offsets_key: Key of the offsets (one vector of 3K numbers).
        sigmas: (K,) standard deviation of each keypoint's offset per axis, metres; or (K, 3), one for each axis.

    Raises:
        InvalidInputError: A sigma is not positive (leave the offsets out instead of fixing them).
    """
    if isinstance(sigmas, np.ndarray) and sigmas.ndim == 2:
        return _zero_prior(offsets_key, finite_array("sigmas", sigmas, (None, 3)).ravel())
    return _zero_prior(offsets_key, np.repeat(finite_array("sigmas", sigmas, (None,)), 3))


def _zero_prior(key: int, sigmas: ArrayLike) -> gtsam.PriorFactorVector:
    noise = diagonal_noise("sigma", sigmas)
    return gtsam.PriorFactorVector(key, np.zeros(noise.dim()), noise)
