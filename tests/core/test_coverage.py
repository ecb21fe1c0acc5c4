"""Coverage of claimed regions, against Gaussians whose covariance is known."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fgrecon.core.coverage import LEVELS, Region, coverage


def regions(times=1.0, dimension=3, count=4000, groups=8, seed=0):
    """Errors of estimates whose true standard deviation is so many times the claimed one, which varies."""
    rng = np.random.default_rng(seed)
    found = []
    for number in range(count):
        sigma = rng.uniform(0.1, 2.0)
        error = times * sigma * rng.standard_normal(dimension)
        squared = float(error @ error) / sigma**2
        found.append(Region(f"g{number % groups}", "position", squared, dimension, sigma, float(np.linalg.norm(error))))
    return found


@pytest.mark.parametrize("dimension", [1, 2, 3])
def test_right_covariances_hold_what_they_claim(dimension):
    (one,) = coverage(regions(dimension=dimension))
    assert one.count == 4000
    np.testing.assert_allclose(one.claimed, LEVELS, atol=0.03)
    for level in (0.68, 0.95):
        for kind in ("claimed", "scaled", "constant"):
            assert one.inside[level][kind] == pytest.approx(level, abs=0.02)
        assert one.width[level]["scaled"] == pytest.approx(one.width[level]["claimed"], rel=0.03)
    # One size for all must reach the largest errors, which wide covariances know of.
    assert one.width[0.95]["constant"] > 1.1 * one.width[0.95]["claimed"]


def test_covariances_that_are_too_small_are_scaled():
    (one,) = coverage(regions(times=2.0))
    assert one.inside[0.95]["claimed"] < 0.6
    assert one.inside[0.95]["scaled"] == pytest.approx(0.95, abs=0.02)
    assert one.width[0.95]["scaled"] == pytest.approx(2.0 * one.width[0.95]["claimed"], rel=0.05)


def test_a_group_does_not_vouch_for_itself():
    """A drive whose errors are ten times those of the others is not covered by them."""
    calm, wild = regions(count=500, groups=5), regions(times=10.0, count=100, groups=1, seed=1)
    moved = [Region("wild", r.quantity, r.squared, r.dimension, r.spread, r.error) for r in wild]
    (one,) = coverage([*calm, *moved])
    assert one.inside[0.95]["scaled"] < 0.9
    (alone,) = coverage(moved)
    assert np.isnan(alone.inside[0.95]["scaled"])
    assert np.isnan(alone.width[0.95]["constant"])


def test_quantities_stay_apart():
    yaw = [Region(r.group, "yaw", r.squared, r.dimension, r.spread, r.error) for r in regions(dimension=1, count=50)]
    assert [(one.quantity, one.count) for one in coverage([*regions(count=60), *yaw])] == [
        ("position", 60),
        ("yaw", 50),
    ]
    assert coverage([]) == []


@given(st.lists(st.floats(0.0, 50.0), min_size=2, max_size=40))
def test_shares_grow_with_the_level(squares):
    (one,) = coverage([Region(str(n % 3), "yaw", value, 1, 1.0, value**0.5) for n, value in enumerate(squares)])
    assert (np.diff(one.claimed) >= 0).all()
    assert one.inside[0.95]["claimed"] >= one.inside[0.68]["claimed"]
