"""Range and range rate: Jacobians against the numeric ones, and what they measure."""

from __future__ import annotations

import gtsam
import numpy as np
import pytest
from gtsam.utils.numerical_derivative import numericalDerivative11

from factors import L, X
from factors.keys import V
from factors.mixture import Form
from factors.vehicle_range import RangeFactor, RangeRows, range_rate_factor

SIZE = np.array([4.0, 1.8, 1.5])
BASIS = np.array([[0.4, 0.1], [0.05, 0.1], [0.02, 0.15]])
PLACES = {
    "ahead": np.array([0.0, 1.6, 20.0]),
    "aside and above": np.array([4.0, 3.0, 6.0]),
    "seen from below": np.array([1.0, -2.0, 5.0]),
}


def values_at(place: np.ndarray, yaw: float = -1.2) -> gtsam.Values:
    values = gtsam.Values()
    values.insert(X(0, 0), gtsam.Pose3(gtsam.Rot3.Ry(yaw), place))
    values.insert(L(0), np.array([0.3, -0.5]))
    values.insert(V(0, 0), np.array([12.0, 0.3, 0.1]))
    return values


def with_(values: gtsam.Values, key: int, value: object) -> gtsam.Values:
    other = gtsam.Values(values)
    other.update(key, value)
    return other


@pytest.mark.parametrize("to_centre", [True, False])
@pytest.mark.parametrize("place", PLACES.values(), ids=PLACES)
def test_the_range_has_the_numeric_jacobian(place: np.ndarray, to_centre: bool) -> None:
    rows = RangeRows(9.0, 0.1, np.array([0.2, 0.4, 1.5]), SIZE, BASIS, to_centre=to_centre)
    factor, values = RangeFactor(rows, X(0, 0), L(0)), values_at(place)
    _, jacobian = factor(values, want_jacobian=True)

    def residual(key: int, value: object) -> np.ndarray:
        return factor(with_(values, key, value), want_jacobian=False)[0]

    by_pose = numericalDerivative11(lambda pose: residual(X(0, 0), pose), values.atPose3(X(0, 0)))
    by_shape = numericalDerivative11(lambda x: residual(L(0), x), values.atVector(L(0)))
    assert jacobian == pytest.approx(np.hstack([by_pose, by_shape]), abs=1e-5)


def test_it_is_the_distance_from_the_nearest_side() -> None:
    values = values_at(np.array([0.0, 1.6, 20.0]), yaw=np.pi / 2.0)  # along the view: half a length before its middle
    values.update(L(0), np.zeros(2))
    rows = RangeRows(18.0, 0.1, np.array([0.0, 1.0, 0.0]), SIZE, BASIS)
    assert RangeFactor(rows, X(0, 0), L(0))(values, want_jacobian=False)[0] == pytest.approx(0.0, abs=1e-9)
    centre = RangeRows(20.0, 0.1, np.array([0.0, 0.85, 0.0]), SIZE, BASIS, to_centre=True)
    assert RangeFactor(centre, X(0, 0), L(0)).energy(values) == pytest.approx(0.0, abs=1e-9)


def test_it_is_silent_where_it_counts_for_nothing() -> None:
    factor, values = RangeFactor(RangeRows(9.0, 0.1, np.zeros(3), SIZE, BASIS), X(0, 0), L(0)), values_at(SIZE)
    factor.tell(Form.WEIGHTED, np.inf)
    residual, jacobian = factor(values, want_jacobian=True)
    assert jacobian is not None
    assert not residual.any()
    assert not jacobian.any()
    factor.tell(Form.NEWTON)
    assert factor.factor().error(values) == pytest.approx(factor.energy(values))


@pytest.mark.parametrize("sensor", [np.zeros(3), np.array([0.5, 0.0, 9.0])])
def test_the_range_rate_has_the_numeric_jacobian(sensor: np.ndarray) -> None:
    keys, values = (X(0, 0), V(0, 0)), values_at(np.array([5.0, 1.6, 9.0]))
    factor = range_rate_factor(keys, 3.0, 0.2, np.array([0.3, 0.5, 1.0]), np.array([0.0, -0.75, 0.0]), sensor)

    def residual(key: int, value: object) -> np.ndarray:
        return factor.whitenedError(with_(values, key, value))

    jacobian, right = factor.linearize(values).jacobian()
    by_pose = numericalDerivative11(lambda pose: residual(X(0, 0), pose), values.atPose3(X(0, 0)))
    by_velocity = numericalDerivative11(lambda v: residual(V(0, 0), v), values.atVector(V(0, 0)))
    assert jacobian == pytest.approx(np.hstack([by_pose, by_velocity]), abs=1e-5)
    assert right == pytest.approx(-residual(X(0, 0), values.atPose3(X(0, 0))))


def test_a_vehicle_ahead_that_drives_away_has_its_speed_less_the_sensors() -> None:
    values = values_at(np.array([0.0, 1.6, 100.0]), yaw=-np.pi / 2.0)  # faces away
    values.update(V(0, 0), np.array([20.0, 0.0, 0.0]))
    sensor = np.array([0.0, 0.0, 15.0])
    factor = range_rate_factor((X(0, 0), V(0, 0)), 5.0, 1.0, np.zeros(3), np.zeros(3), sensor)
    assert factor.error(values) < 1e-4
