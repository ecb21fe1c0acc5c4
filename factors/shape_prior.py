"""Gaussian priors on the shape: lambda ~ N(0, I) (the paper's Eq. 1) and offsets ~ N(0, sigma_k^2 I).

Both are linear in one variable, so that GTSAM's own prior factor, which needs no Python callback, does. Where the fleet
of a vehicle is not known lambda spreads more widely, or is about the mean of a fleet that is a variable.
"""

from __future__ import annotations

import gtsam
import numpy as np
from numpy.typing import ArrayLike

from factors.arrays import Array
from factors.checks import finite_array
from factors.errors import InvalidInputError
from factors.keys import S
from factors.linear import ZeroPrior
from factors.marginals import Marginal, marginal_factor
from factors.noise import diagonal_noise
from factors.shape_factor import ShapeContext, ShapeTerm

SMALLEST_OFFSET_SIGMA = 1e-4
"""Metres; a standard deviation of zero would make the system singular."""


class CoefficientsTerm(ShapeTerm):
    """The prior on lambda."""

    name = "coefficients"

    def applies(self, about: ShapeContext) -> bool:
        """Whether lambda is a variable."""
        return about.shape.coefficients_key is not None

    def factors(self, about: ShapeContext) -> list[gtsam.NonlinearFactor]:
        """One factor."""
        key = about.shape.coefficients_key
        assert key is not None
        if about.by_size is not None:
            return [_about_fleet(key, about.by_size)]
        if about.spread is not None:
            return [spread_prior(key, about.spread)]
        return [coefficients_prior(key, len(about.shape.basis))]


class OffsetsTerm(ShapeTerm):
    """The prior on the offsets."""

    name = "offsets"

    def applies(self, about: ShapeContext) -> bool:
        """Whether the offsets are variables."""
        return about.shape.offsets_key is not None

    def factors(self, about: ShapeContext) -> list[gtsam.NonlinearFactor]:
        """One factor; where symmetry makes one offset of the two of a pair each has twice the variance."""
        assert about.shape.offsets_key is not None
        spread = np.maximum(about.offset_sigma, SMALLEST_OFFSET_SIGMA)
        if "symmetry" not in about.disabled:
            spread = spread * np.where(about.mirror != np.arange(len(about.mirror)), np.sqrt(2.0), 1.0)
        return [offsets_prior(about.shape.offsets_key, spread)]


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


def spread_prior(key: int, covariance: Array) -> gtsam.PriorFactorVector:
    """N(0, covariance) of a vector."""
    return ZeroPrior(key, gtsam.noiseModel.Gaussian.Covariance(covariance))


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


def _about_fleet(key: int, by_size: Array) -> gtsam.CustomFactor:
    """N(0, I) of lambda about the mean of a fleet S that is larger than the prior's by so much; by_size (N, 3)."""
    count, at = len(by_size), gtsam.Values()
    at.insert(key, np.zeros(count))
    at.insert(S(), np.zeros(3))
    return marginal_factor(Marginal((key, S()), (count, 3), at, np.hstack([np.eye(count), -by_size]), np.zeros(count)))


def _zero_prior(key: int, sigmas: ArrayLike) -> gtsam.PriorFactorVector:
    return ZeroPrior(key, diagonal_noise("sigma", sigmas))
