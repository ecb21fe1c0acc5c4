"""Bootstrap intervals against closed forms."""

import numpy as np
import pytest

from fgrecon.core.errors import InvalidInputError
from fgrecon_research.evaluation.bootstrap import mean_interval, median_interval, statistic_interval


def test_a_mean_has_the_interval_of_the_central_limit():
    values = np.random.default_rng(3).normal(5.0, 2.0, 2000)
    found = mean_interval(values)
    assert found.value == pytest.approx(values.mean())
    half = 1.96 * values.std() / np.sqrt(len(values))
    assert found.low == pytest.approx(found.value - half, abs=0.15 * half)
    assert found.high == pytest.approx(found.value + half, abs=0.15 * half)


def test_copies_within_a_group_tell_nothing_new():
    single = np.random.default_rng(4).normal(size=100)
    alone = mean_interval(single)
    copied = mean_interval(np.repeat(single, 10), groups=np.repeat(np.arange(100), 10))
    assert (copied.value, copied.low, copied.high) == pytest.approx((alone.value, alone.low, alone.high))
    ignorant = mean_interval(np.repeat(single, 10))
    assert ignorant.high - ignorant.low < 0.5 * (alone.high - alone.low)


def test_groups_of_different_size_keep_the_mean_of_all_values():
    values, groups = np.array([1.0, 1.0, 1.0, 5.0]), np.array([7, 7, 7, 9])
    assert mean_interval(values, groups).value == 2.0
    assert mean_interval(values, groups).low == 1.0
    assert mean_interval(values, groups).high == 5.0


def test_a_median_with_its_interval_and_failures():
    values = np.array([1.0, 2.0, 3.0, np.inf])
    found = statistic_interval(values, lambda sample: float(np.sort(sample)[1]))
    assert found.value == 2.0
    assert found.low == 1.0
    assert found.high == np.inf


@pytest.mark.parametrize("count", [40, 41])
def test_a_median_of_groups_is_that_of_the_groups_drawn_one_by_one(count):
    rng = np.random.default_rng(5)
    values, groups = rng.normal(size=count), rng.integers(9, size=count)
    names = np.unique(groups)
    draws = np.random.default_rng(0).multinomial(len(names), np.full(len(names), 1 / len(names)), 1000)
    samples = [
        np.median(np.concatenate([np.tile(values[groups == name], n) for name, n in zip(names, draw, strict=True)]))
        for draw in draws
    ]
    found = median_interval(values, groups)
    expected = np.percentile(samples, [2.5, 97.5], method="nearest")
    assert (found.value, found.low, found.high) == pytest.approx((np.median(values), *expected), abs=1e-12)


def test_a_median_of_single_values_has_the_interval_of_order_statistics():
    values = np.arange(1000.0)
    found = median_interval(values)
    half = 1.96 * np.sqrt(1000) / 2  # the binomial's, in ranks
    assert (found.low, found.high) == pytest.approx((499.5 - half, 499.5 + half), abs=6)


def test_the_same_seed_gives_the_same_samples():
    values = np.arange(10.0)
    found = statistic_interval(values, np.max, 1)
    assert found == statistic_interval(values, np.max, 1)
    assert {found.low, found.high} <= set(values)


def test_nothing_to_average_is_refused():
    with pytest.raises(InvalidInputError, match="no instance"):
        mean_interval([])
    with pytest.raises(InvalidInputError, match="groups"):
        mean_interval([1.0, 2.0], groups=[1])
