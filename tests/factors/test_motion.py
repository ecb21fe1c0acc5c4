"""Motion of a vehicle: derivatives, what they say of paths that are known, and variables that leave a graph."""

import gtsam
import numpy as np
import pytest

from factors import L, M, Marginal, V, X, drive_factor, marginal, marginal_factor, motion_factor
from factors.errors import InvalidInputError
from factors.keys import decode_key, key_name
from factors.motion import moved
from tests.factors.support import assert_jacobian, graph_of, optimize, random_pose

NOISE = gtsam.noiseModel.Diagonal.Sigmas(np.array([0.02, 0.03, 0.02, 0.1, 0.05, 0.2]))
CAMERA = gtsam.Pose3(gtsam.Rot3.RzRyRx(0.01, -0.05, 0.02), np.array([0.1, 0.02, 1.3]))


def values_of(first, velocity, second):
    values = gtsam.Values()
    values.insert(X(0, 0), first)
    values.insert(V(0, 0), np.asarray(velocity, dtype=float))
    values.insert(X(0, 1), second)
    return values


@pytest.mark.parametrize("camera", [None, CAMERA], ids=["standing", "moving"])
def test_jacobian_of_the_motion(camera):
    rng = np.random.default_rng(0)
    factor = motion_factor(X(0, 0), V(0, 0), X(0, 1), 0.1, NOISE, camera)
    for _ in range(5):
        first, velocity = random_pose(rng), rng.normal(size=3) * [10.0, 1.0, 0.5]
        second = moved(first, velocity, 0.1, camera or gtsam.Pose3()).retract(0.1 * rng.normal(size=6))
        assert_jacobian(factor, values_of(first, velocity, second))


@pytest.mark.parametrize("radius", [None, 5.0])
def test_jacobian_of_what_a_vehicle_can_drive(radius):
    rng = np.random.default_rng(1)
    factor = drive_factor(V(), gtsam.noiseModel.Isotropic.Sigma(3, 0.4), radius)
    for speed in (0.0, 0.3, 20.0):
        values = gtsam.Values()
        values.insert(V(), np.array([speed, 0.1, 0.3]) + 0.01 * rng.normal(size=3))
        assert_jacobian(factor, values)


def test_a_path_of_constant_velocity_and_turn_rate_has_no_residual():
    """A quarter of a circle of 10 m radius: forward 10 m/s, a radian a second to the right."""
    start = gtsam.Pose3(gtsam.Rot3(), np.array([0.0, 1.65, 20.0]))  # faces the camera's x
    end = moved(start, [10.0, 0.0, 1.0], np.pi / 2.0, gtsam.Pose3())
    np.testing.assert_allclose(end.translation(), [10.0, 1.65, 10.0], atol=1e-9)
    np.testing.assert_allclose(end.rotation().matrix()[:, 0], [0.0, 0.0, -1.0], atol=1e-9)
    factor = motion_factor(X(0, 0), V(0, 0), X(0, 1), np.pi / 2.0, NOISE)
    assert factor.error(values_of(start, [10.0, 0.0, 1.0], end)) == pytest.approx(0.0, abs=1e-12)


def test_a_moving_camera_sees_a_standing_vehicle_move():
    world_T_vehicle = gtsam.Pose3(gtsam.Rot3.Ry(0.7), np.array([3.0, 1.65, 25.0]))
    first, second = world_T_vehicle, CAMERA.inverse().compose(world_T_vehicle)
    factor = motion_factor(X(0, 0), V(0, 0), X(0, 1), 0.1, NOISE, CAMERA)
    assert factor.error(values_of(first, [0.0, 0.0, 0.0], second)) == pytest.approx(0.0, abs=1e-12)
    standing = motion_factor(X(0, 0), V(0, 0), X(0, 1), 0.1, NOISE)
    assert standing.error(values_of(first, [0.0, 0.0, 0.0], second)) > 10.0


def test_a_standing_vehicle_does_not_turn():
    factor = drive_factor(V(), gtsam.noiseModel.Isotropic.Sigma(3, 1.0), 5.0)
    values = gtsam.Values()
    values.insert(V(), np.array([0.0, 0.0, 0.5]))
    standing = factor.error(values)
    values.update(V(), np.array([10.0, 0.0, 0.5]))
    assert factor.error(values) - 50.0 < standing / 50.0


def test_what_cannot_be_is_refused():
    with pytest.raises(InvalidInputError, match="order of time"):
        motion_factor(X(0, 0), V(0, 0), X(0, 1), 0.0, NOISE)
    with pytest.raises(InvalidInputError, match="least_radius"):
        drive_factor(V(), gtsam.noiseModel.Isotropic.Sigma(3, 1.0), -1.0)


def test_the_key_has_a_name():
    assert decode_key(V(2, 3)) == ("V", 2, 3)
    assert key_name(V(2, 3)) == "V(v=2,t=3)"


def _chain():
    """Two poses, a velocity and a shape: everything that ties the first pose and the velocity to the rest."""
    rng = np.random.default_rng(2)
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    first = random_pose(rng)
    values.insert(X(0, 0), first)
    values.insert(V(0, 0), np.array([5.0, 0.0, 0.1]))
    values.insert(X(0, 1), moved(first, [5.0, 0.1, 0.0], 0.1, gtsam.Pose3()))
    values.insert(V(0, 1), np.array([5.2, 0.0, 0.1]))
    graph.add(gtsam.PriorFactorPose3(X(0, 0), first.retract(0.01 * rng.normal(size=6)), NOISE))
    graph.add(gtsam.PriorFactorVector(V(0, 0), np.array([6.0, 0.0, 0.0]), gtsam.noiseModel.Isotropic.Sigma(3, 1.0)))
    graph.add(motion_factor(X(0, 0), V(0, 0), X(0, 1), 0.1, NOISE))
    walk = gtsam.noiseModel.Isotropic.Sigma(3, 0.5)
    graph.add(gtsam.BetweenFactorVector(V(0, 0), V(0, 1), np.zeros(3), walk))
    return graph, values, walk


def test_what_leaves_a_graph_says_what_it_said():
    """With new evidence on what stayed, the minimum and its covariance are those of the whole graph."""
    graph, values, walk = _chain()
    past = marginal(graph, values, [X(0, 0), V(0, 0)])
    assert past.keys == tuple(sorted([V(0, 1), X(0, 1)]))
    seen = values.atPose3(X(0, 1)).retract(np.array([0.001, 0.002, -0.001, 0.01, 0.0, 0.02]))
    new = [
        gtsam.PriorFactorPose3(X(0, 1), seen, NOISE),
        gtsam.PriorFactorVector(V(0, 1), np.array([5.5, 0.1, 0.0]), walk),
    ]
    for factor in new:
        graph.add(factor)
    whole = optimize(graph, values)
    kept = gtsam.Values(values)
    kept.erase(X(0, 0))
    kept.erase(V(0, 0))
    small = graph_of(marginal_factor(past), *new)
    alone = optimize(small, kept)
    assert alone.atPose3(X(0, 1)).equals(whole.atPose3(X(0, 1)), 1e-4)
    np.testing.assert_allclose(alone.atVector(V(0, 1)), whole.atVector(V(0, 1)), atol=1e-3)
    for key in (X(0, 1), V(0, 1)):
        expected = gtsam.Marginals(graph, whole).marginalCovariance(key)
        np.testing.assert_allclose(
            gtsam.Marginals(small, alone).marginalCovariance(key), expected, rtol=0.02, atol=2e-5
        )
    assert_jacobian(marginal_factor(past), whole_of(kept, seen))
    assert marginal_factor(past.scaled(0.25)).error(alone) == pytest.approx(0.25 * marginal_factor(past).error(alone))


def whole_of(values, pose):
    moved_values = gtsam.Values(values)
    moved_values.update(X(0, 1), pose)
    return moved_values


def test_a_vector_of_any_length_may_stay():
    graph, values, _ = _chain()
    values.insert(L(), np.arange(5.0))
    graph.add(gtsam.PriorFactorVector(L(), np.zeros(5), gtsam.noiseModel.Isotropic.Sigma(5, 2.0)))
    past = marginal(graph, values, [X(0, 0), V(0, 0)])
    assert dict(zip(past.keys, past.dims, strict=True)) == {L(): 5, V(0, 1): 3, X(0, 1): 6}


def test_planes_that_are_left_are_refused():
    values = gtsam.Values()
    values.insert(M(0), gtsam.OrientedPlane3(0.0, 0.0, 1.0, 0.0))
    past = Marginal((M(0),), (3,), values, np.eye(3), np.zeros(3))
    with pytest.raises(InvalidInputError, match="planes"):
        marginal_factor(past)
