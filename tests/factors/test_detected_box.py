"""What another detector's 3D box says of the pose: derivatives, units, and the two modes of the yaw."""

import gtsam
import numpy as np
import pytest

from factors import InvalidInputError, X, detected_origin_factor, detected_yaw_factor
from tests.factors.support import assert_jacobian, graph_of, optimize, random_pose

NOISE = gtsam.noiseModel.Diagonal.Sigmas(np.array([0.01, 0.01, 0.06]))


def values_of(pose):
    values = gtsam.Values()
    values.insert(X(), pose)
    return values


def standing(yaw, place):
    return gtsam.Pose3(gtsam.Rot3.Ry(yaw), np.asarray(place, dtype=float))


def test_jacobians():
    rng = np.random.default_rng(0)
    for _ in range(6):
        pose = random_pose(rng)
        pose = gtsam.Pose3(pose.rotation(), np.abs(pose.translation()) + np.array([0.0, 0.0, 4.0]))
        assert_jacobian(detected_origin_factor(X(), [1.0, 1.5, 20.0], NOISE), values_of(pose))
        assert_jacobian(detected_yaw_factor(X(), rng.uniform(-3, 3), 0.2), values_of(pose))


def test_the_rows_are_tangents_and_a_ratio():
    factor = detected_origin_factor(X(), [2.0, 1.5, 20.0], NOISE)
    assert factor.unwhitenedError(values_of(standing(0.3, [2.0, 1.5, 20.0]))) == pytest.approx(np.zeros(3))
    farther = factor.unwhitenedError(values_of(standing(0.3, [2.2, 1.65, 22.0])))
    assert farther == pytest.approx([0.0, 0.0, np.log(1.1)]), "along the ray the direction stays"
    beside = factor.unwhitenedError(values_of(standing(0.3, [2.5, 1.5, 20.0])))
    assert beside == pytest.approx([0.025, 0.0, 0.0])


@pytest.mark.parametrize("off", [-1.2, -0.2, 0.0, 0.4, 1.5])
@pytest.mark.parametrize("turned", [0.0, np.pi])
def test_the_yaw_is_known_modulo_half_a_turn(off, turned):
    factor = detected_yaw_factor(X(), 0.7, 0.5)
    assert factor.unwhitenedError(values_of(standing(0.7 + off + turned, [0.0, 1.5, 9.0]))) == pytest.approx([off])


@pytest.mark.parametrize(("start", "end"), [(0.9, 0.7), (0.9 + np.pi, 0.7 - np.pi)])
def test_a_solver_stays_on_the_side_where_it_begins(start, end):
    place = np.array([3.0, 1.6, 15.0])
    graph = graph_of(detected_yaw_factor(X(), 0.7, 0.1), detected_origin_factor(X(), place, NOISE))
    graph.add(gtsam.PriorFactorPose3(X(), standing(start, [0, 0, 5]), gtsam.noiseModel.Isotropic.Sigma(6, 1e3)))
    found = optimize(graph, values_of(standing(start, [2.0, 1.0, 12.0]))).atPose3(X())
    assert found.translation() == pytest.approx(place, abs=1e-3)
    forward = found.rotation().matrix()[:, 0]
    assert np.arctan2(-forward[2], forward[0]) == pytest.approx(end, abs=1e-3)


@pytest.mark.parametrize("origin", [[0.0, 0.0, 0.0], [0.0, 0.0, -3.0], [np.nan, 0.0, 5.0], [1.0, 2.0]])
def test_an_origin_that_no_camera_sees_is_refused(origin):
    with pytest.raises(InvalidInputError, match="origin"):
        detected_origin_factor(X(), origin, NOISE)


def test_a_yaw_that_is_none_is_refused():
    with pytest.raises(InvalidInputError, match="yaw"):
        detected_yaw_factor(X(), float("nan"), 0.1)
