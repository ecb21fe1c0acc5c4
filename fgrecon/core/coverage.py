"""Calibration of estimates: coverage of confidence regions, and reliability of probabilities.

An estimate claims a Gaussian; its region of a probability p holds the errors whose squares by its covariance are at
most the chi-square quantile of p. Two baselines make regions that hold by construction where data are exchangeable
(split conformal prediction, Vovk et al. 2005): `scaled` takes the quantile of the squares on other groups instead,
which keeps the covariance's shape; `constant` that of the plain errors, which asks no covariance at all. Each group is
left out of its own quantile, so that vehicles of one drive do not vouch for each other.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fgrecon.core.arrays import Array

LEVELS = np.round(np.arange(0.05, 1.0, 0.05), 2)
"""Probabilities at which coverage is looked at."""
SIGMAS = (0.68, 0.95)
"""Those at which widths are compared."""


@dataclass(frozen=True)
class Region:
    """What one estimate claims, and how far off it is."""

    group: str  # what it is left out with, such as a drive
    quantity: str  # what is estimated
    squared: float  # squared error by its covariance
    dimension: int  # of the error
    spread: float  # geometric mean of the one-sigma region's semi-axes, in the quantity's unit
    error: float  # length of the error in that unit


@dataclass(frozen=True)
class Coverage:
    """Regions of one quantity."""

    quantity: str  # what was estimated
    count: int  # number of estimates
    claimed: Array  # (L,) share within their region of each of `LEVELS`
    # share within their own, the scaled and the constant region at each of `SIGMAS`; the baselines' are NaN with
    # a single group
    inside: dict[float, dict[str, float]]
    width: dict[float, dict[str, float]]  # mean radius of these regions, in the quantity's unit


def coverage(regions: Sequence[Region]) -> list[Coverage]:
    """The coverage of each quantity, in the order in which they come."""
    names = dict.fromkeys(region.quantity for region in regions)
    return [_coverage(name, [region for region in regions if region.quantity == name]) for name in names]


def _coverage(name: str, regions: Sequence[Region]) -> Coverage:
    from scipy.stats import chi2  # on use: it takes long to import

    squared = np.array([region.squared for region in regions])
    spread = np.array([region.spread for region in regions])
    error = np.array([region.error for region in regions])
    dimension = regions[0].dimension
    groups = np.array([region.group for region in regions])
    inside: dict[float, dict[str, float]] = {}
    width: dict[float, dict[str, float]] = {}
    for level in SIGMAS:
        quantile = float(chi2.ppf(level, dimension))
        scaled, constant = _quantiles(squared, groups, level), _quantiles(error, groups, level)
        inside[level] = {
            "claimed": float(np.mean(squared <= quantile)),
            "scaled": _share(squared <= scaled, scaled),
            "constant": _share(error <= constant, constant),
        }
        width[level] = {
            "claimed": float(np.mean(spread) * np.sqrt(quantile)),
            "scaled": float(np.mean(spread * np.sqrt(scaled))),
            "constant": float(np.mean(constant)),
        }
    claimed = np.array([np.mean(squared <= quantile) for quantile in chi2.ppf(LEVELS, dimension)])
    return Coverage(name, len(regions), claimed, inside, width)


def _quantiles(values: Array, groups: NDArray[np.str_], level: float) -> Array:
    """For each value (M,) the quantile of those of other groups; NaN where there are none."""
    found = np.full(len(values), np.nan)
    for group in np.unique(groups):
        others = np.sort(values[groups != group])
        if len(others):
            place = int(np.ceil((len(others) + 1) * level)) - 1  # of one more, unseen value
            found[groups == group] = others[min(place, len(others) - 1)]
    return found


def _share(inside: NDArray[np.bool_], known: Array) -> float:
    return float(np.mean(inside)) if np.isfinite(known).all() else float("nan")


@dataclass(frozen=True)
class Reliability:
    """How often statements of a confidence are right; arrays of B bins that hold equally many statements."""

    confidence: NDArray[np.float64]  # (B,) mean confidence
    right: NDArray[np.float64]  # (B,) share that is right
    count: NDArray[np.int64]  # (B,) number of statements

    @property
    def error(self) -> float:
        """Expected calibration error: mean distance of the two, by number of statements."""
        return float(np.abs(self.confidence - self.right) @ self.count / max(self.count.sum(), 1))


def reliability(confidence: ArrayLike, right: ArrayLike, bins: int = 10) -> Reliability:
    """Sort statements (any shape) by confidence into bins of equal size."""
    sure, hit = np.ravel(confidence).astype(np.float64), np.ravel(right).astype(np.float64)
    parts = [part for part in np.array_split(np.argsort(sure, kind="stable"), bins) if len(part)]
    return Reliability(
        np.array([sure[part].mean() for part in parts]),
        np.array([hit[part].mean() for part in parts]),
        np.array([len(part) for part in parts], dtype=np.int64),
    )
