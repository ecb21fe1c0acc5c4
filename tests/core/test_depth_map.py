"""Depth maps as they are given: what is valid, what is refused, and what their numbers are in metres."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from fgrecon import DepthCalibration, DepthMap, DepthScale
from fgrecon.errors import InvalidInputError

DEPTH = np.array([[np.nan, 0.0, 5.0, 10.0]] * 10)


def test_what_was_not_measured_is_none() -> None:
    assert np.isfinite(DepthMap(DEPTH).depth).sum() == 20
    assert np.isfinite(DepthMap(DEPTH, inverse=True, scale=DepthScale.SCALE).depth).sum() == 30  # infinitely far
    assert np.isfinite(DepthMap(DEPTH, scale=DepthScale.SCALE_AND_SHIFT).depth).sum() == 30


def test_metres_and_their_deviations() -> None:
    inverse = DepthMap(DEPTH, sigma=0.1, relative_sigma=0.02, scale=DepthScale.SCALE_AND_SHIFT, inverse=True)
    metres = inverse.metres(np.array([5.0, 10.0, -9.0]), DepthCalibration(0.01, 0.05))
    assert metres[:2] == pytest.approx([10.0, 1.0 / 0.15])
    assert np.isnan(metres[2])
    row, column = np.array([0, 0]), np.array([2, 3])
    along = inverse.along(row, column, metres[:2], 0.01)
    assert along == pytest.approx(np.hypot(0.01 * 0.1 * metres[:2] ** 2, 0.02 * metres[:2]))
    assert inverse.known is None
    assert DepthMap(DEPTH).known is not None
    assert (
        DepthMap(DEPTH, calibration=DepthCalibration(2.0, 1.0)).metres(np.array([5.0]), DepthCalibration(2.0, 1.0))
        == 11.0
    )


@pytest.mark.parametrize(
    ("given", "named"),
    [
        ({"depth": DEPTH[0]}, "depth"),
        ({"depth": DEPTH * 1e3}, "depth.*scale="),
        ({"depth": DEPTH / 100.0}, "depth.*scale="),
        ({"sigma": -1.0}, "depth.sigma"),
        ({"sigma": np.full(DEPTH.shape, np.nan)}, "depth.sigma"),
        ({"relative_sigma": 0.0}, "depth.sigma"),
        ({"relative_sigma": 2.0}, "depth.relative_sigma"),
        ({"shared_sigma": -0.1}, "depth.shared_sigma"),
        ({"shared_sigma": 1e-200}, "depth.shared_sigma"),
        ({"sensor": ["a"]}, "depth.sensor"),
        ({"scale": "metre"}, "depth.scale"),
    ],
)
def test_bad_maps_are_refused(given: dict[str, Any], named: str) -> None:
    with pytest.raises(InvalidInputError, match=f"^{named}"):
        DepthMap(**{"depth": DEPTH, **given})


@pytest.mark.parametrize(
    ("given", "named"),
    [((0.0, 0.0), "scale"), ((1.0, np.nan), "shift"), ((1.0, 0.0, [[1.0, 2.0], [2.0, 1.0]]), "covariance")],
)
def test_bad_calibrations_are_refused(given: tuple[Any, ...], named: str) -> None:
    with pytest.raises(InvalidInputError, match=named):
        DepthCalibration(*given)
