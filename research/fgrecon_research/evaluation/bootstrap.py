"""Confidence intervals of a table's numbers: percentile bootstrap."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fgrecon.core.checks import as_shape
from fgrecon.core.errors import InvalidInputError

_SAMPLES = 1000
_LEVEL = 0.95


@dataclass(frozen=True)
class Interval:
    """A statistic and the interval that holds it with 95 % confidence."""

    value: float
    low: float
    high: float


def shown(interval: Interval | None, tracks: int, digits: int, factor: float = 1.0) -> str:
    """`value (low-high)` with so many digits, in another unit where a factor is given; a dash for None.

    Of a single track nothing can be drawn: there it is the value alone.
    """
    if interval is None:
        return "-"
    value, low, high = (f"{factor * number:.{digits}f}" for number in (interval.value, interval.low, interval.high))
    return f"{value} ({low}-{high})" if tracks > 1 else value


def mean_interval(values: ArrayLike, groups: ArrayLike | None = None, seed: int = 0) -> Interval:
    """Mean of values (M,) with its interval.

    Args:
        groups: (M,) whole numbers: instances of one group (such as one image) are drawn together, since what goes
            wrong in one may go wrong in the others; None draws each by itself.

    Raises:
        InvalidInputError: There is no value, or the lengths differ.
    """
    numbers = _checked(values)
    member = _members(numbers, groups)
    sums, counts = np.bincount(member, numbers), np.bincount(member)
    weights = _draws(len(sums), seed)
    means = weights @ sums / (weights @ counts)
    return _interval(float(numbers.mean()), means)


def median_interval(values: ArrayLike, groups: ArrayLike | None = None, seed: int = 0) -> Interval:
    """Median of values (M,) with its interval; arguments and errors are those of `mean_interval`."""
    numbers = _checked(values)
    member, order = _members(numbers, groups), np.argsort(numbers)
    draws = _draws(int(member.max()) + 1, seed)
    below = np.cumsum(draws[:, member[order]], axis=1)  # (S, M) how many of a sample are up to each
    half = 0.5 * below[:, -1:]
    lower, upper = (below < half).sum(axis=1), (below <= half).sum(axis=1)  # the two in the middle, or twice the one
    return _interval(float(np.median(numbers)), 0.5 * (numbers[order][lower] + numbers[order][upper]))


def statistic_interval(values: ArrayLike, statistic: Callable[[NDArray[np.float64]], float], seed: int = 0) -> Interval:
    """Any statistic of values (M,), such as the median, with its interval; each value is drawn by itself."""
    numbers = _checked(values)
    samples = numbers[np.random.default_rng(seed).integers(len(numbers), size=(_SAMPLES, len(numbers)))]
    return _interval(float(statistic(numbers)), np.array([statistic(sample) for sample in samples]))


def _draws(groups: int, seed: int) -> NDArray[np.int64]:
    """(S, G) how often each group is in each sample."""
    return np.random.default_rng(seed).multinomial(groups, np.full(groups, 1.0 / groups), _SAMPLES)


def _checked(values: ArrayLike) -> NDArray[np.float64]:
    numbers = as_shape("values", values, (None,))
    if not len(numbers):
        raise InvalidInputError("values", "no instance", "Give at least one.")
    return numbers


def _members(values: NDArray[np.float64], groups: ArrayLike | None) -> NDArray[np.intp]:
    """(M,) number of the group of each value, from 0."""
    if groups is None:
        return np.arange(len(values))
    labels = np.asarray(groups)
    if labels.shape != values.shape:
        raise InvalidInputError("groups", f"shape {labels.shape}", f"Give {len(values)} numbers.")
    return np.asarray(np.unique(labels, return_inverse=True)[1])


def _interval(value: float, samples: NDArray[np.float64]) -> Interval:
    tail = 50.0 * (1.0 - _LEVEL)
    with np.errstate(invalid="ignore"):
        low, high = np.percentile(samples, [tail, 100.0 - tail], method="nearest")
    return Interval(value, float(low), float(high))
