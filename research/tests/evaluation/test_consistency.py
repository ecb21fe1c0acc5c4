"""Squared errors by their covariances, where the covariances are right, too small and too large."""

import numpy as np
import pytest

from fgrecon.calibration.labelled_boxes import normalised_squared_error
from fgrecon_research.evaluation.video_summary import consistency

COVARIANCE = np.array([[4.0, 1.0, 0.0], [1.0, 2.0, 0.3], [0.0, 0.3, 0.1]])


def drawn(factor, count=4000):
    rng = np.random.default_rng(0)
    errors = rng.multivariate_normal(np.zeros(3), COVARIANCE, count)
    return [normalised_squared_error(error, factor * COVARIANCE) for error in errors]


def test_right_covariances_are_within_the_bounds():
    found = consistency(drawn(1.0), 3, 4000)
    assert found.low < found.mean < found.high
    assert (found.low, found.high) == pytest.approx((1.0, 1.0), abs=0.05)
    assert found.inside == pytest.approx(95.0, abs=1.0)
    assert found.median == pytest.approx(1.0, abs=0.05)
    assert found.count == 4000


@pytest.mark.parametrize(("factor", "sign"), [(0.25, 1), (4.0, -1)], ids=["too small", "too large"])
def test_wrong_ones_are_outside(factor, sign):
    found = consistency(drawn(factor), 3, 40)
    assert sign * (found.mean - (found.high if sign > 0 else found.low)) > 0.0
    assert found.mean == pytest.approx(1.0 / factor, rel=0.05)
    assert sign * (found.inside - 95.0) < 0.0


def test_few_tracks_leave_wide_bounds():
    few, many = (consistency([1.0], 1, tracks) for tracks in (2, 200))
    assert few.low < many.low < 1.0 < many.high < few.high


def test_nothing_to_compare():
    assert consistency([], 3, 0) is None
    assert normalised_squared_error(np.ones(2), np.array([[1.0, 2.0], [2.0, 1.0]])) is None
