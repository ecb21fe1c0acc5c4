"""Whether estimates are as sure as they say: squared errors by their own covariances (NEES).

The normalised estimation error squared of an estimate whose covariance is right is a chi-square variable; divided by
its dimension its mean is 1. Errors of one track go together, so the bounds about 1 are those of as many draws as there
are tracks: a mean above them says that covariances are too small, one below that they are too large.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

Array = NDArray[np.float64]

_SHARE = 0.95


@dataclass(frozen=True)
class Consistency:
    """How squared errors compare with their covariances."""

    mean: float  # of the normalised squared errors, by dimension; 1 where covariances are right
    low: float  # between which it is, 95 times of 100, where they are right
    high: float
    median: float  # the median over that of the chi-square distribution; 1 where covariances are right
    inside: float  # percent of the errors within their 95 % region
    count: int  # number of estimates


def consistency(errors: Sequence[float], dimension: int, tracks: int) -> Consistency | None:
    """Compare normalised squared errors with what right covariances make of them; None without an error.

    Args:
        errors: Of each estimate.
        dimension: Of what is estimated.
        tracks: Number of tracks that the estimates are of.
    """
    if not len(errors):
        return None
    low, high = (float(chi2.ppf(p, dimension * tracks)) / (dimension * tracks) for p in (0.025, 0.975))
    return Consistency(
        mean=float(np.mean(errors)) / dimension,
        low=low,
        high=high,
        median=float(np.median(errors) / chi2.ppf(0.5, dimension)),
        inside=100.0 * float(np.mean(np.array(errors) <= chi2.ppf(_SHARE, dimension))),
        count=len(errors),
    )
