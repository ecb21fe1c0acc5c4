"""Vehicles on a ground that is a variable: derivatives, the nominal plane, and the plane of several vehicles."""

import gtsam
import numpy as np
import pytest

from factors import X
from factors.contact import GroundFrame, contact_factor
from factors.ground import GroundRows
from factors.keys import G, decode_key, key_name
from tests.factors.support import assert_jacobian, graph_of, optimize, random_pose

NORMAL = np.array([0.05, 1.0, -0.1]) / np.linalg.norm([0.05, 1.0, -0.1])
NOISE = gtsam.noiseModel.Diagonal.Sigmas(np.array([0.05, 0.02, 0.02, 0.02]))


def values_of(pose, change):
    values = gtsam.Values()
    values.insert(X(), pose)
    values.insert(G(), np.asarray(change, dtype=float))
    return values


@pytest.mark.parametrize("normal", [NORMAL, [0, 1, 0], [0, 0, 1], [0.3, 0.2, 0.9]], ids=str)
def test_jacobian(normal):
    rng = np.random.default_rng(0)
    frame = GroundFrame.of(normal, 1.7)
    np.testing.assert_allclose(frame.across @ frame.normal, 0.0, atol=1e-12)
    np.testing.assert_allclose(frame.across @ frame.across.T, np.eye(2), atol=1e-12)
    for _ in range(5):
        assert_jacobian(contact_factor(X(), G(), frame, NOISE), values_of(random_pose(rng), 0.2 * rng.normal(size=3)))


def test_at_the_nominal_plane_it_is_the_constant_grounds():
    pose = random_pose(np.random.default_rng(1))
    contact = contact_factor(X(), G(), GroundFrame.of(NORMAL, 1.7), NOISE)
    constant = GroundRows(NORMAL, 1.7, 0.02).energy(pose.rotation().matrix(), pose.translation(), 0.05)
    values = values_of(pose, np.zeros(3))
    assert contact.error(values) == pytest.approx(constant, rel=1e-12)


def test_pitch_and_roll_are_the_cameras():
    """Level: a pitch brings the road ahead nearer to the camera's height, a roll lifts one side."""
    frame = GroundFrame.of([0, 1, 0], 1.65)
    pitched, distance = frame.plane(np.array([0.1, 0.02, 0.0]))
    assert distance == pytest.approx(1.75)
    assert (pitched @ [0, 0, 1], pitched @ [1, 0, 0]) == pytest.approx((0.02, 0.0), abs=1e-4)
    rolled, _ = frame.plane(np.array([0.0, 0.0, 0.02]))
    assert abs(rolled @ [1, 0, 0]) == pytest.approx(0.02, abs=1e-4)


def test_vehicles_tell_the_plane_they_stand_on():
    """Poses known well, ground hardly: the plane is theirs, as least squares has it."""
    rng = np.random.default_rng(2)
    frame, truth = GroundFrame.of([0, 1, 0], 1.65), np.array([0.2, 0.03, -0.02])
    normal, distance = frame.plane(truth)
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    values.insert(G(), np.zeros(3))
    for vehicle in range(6):
        flat = np.array([rng.uniform(-8, 8), 0.0, rng.uniform(8, 50)])
        place = flat + np.array([0.0, 1.0, 0.0]) * (distance - normal @ flat) / normal[1]
        axis = np.cross([0.0, 1.0, 0.0], normal)
        pose = gtsam.Pose3(gtsam.Rot3.Expmap(axis) * gtsam.Rot3.Ry(rng.uniform(-3, 3)), place)
        values.insert(X(vehicle, 0), pose)
        graph.add(gtsam.PriorFactorPose3(X(vehicle, 0), pose, gtsam.noiseModel.Isotropic.Sigma(6, 1e-4)))
        graph.add(contact_factor(X(vehicle, 0), G(), frame, NOISE))
    found = optimize(graph, values).atVector(G())
    np.testing.assert_allclose(found, truth, atol=2e-3)
    assert graph_of(contact_factor(X(0, 0), G(), frame, NOISE)).error(values) > 1.0


def test_a_vehicle_that_stands_lower_than_its_pose_is_on_a_plane_that_is_lifted():
    frame, pose = GroundFrame.of(NORMAL, 1.5), random_pose(np.random.default_rng(3))
    lower = gtsam.Pose3(pose.rotation(), np.asarray(pose.translation()) + 0.4 * frame.normal)
    there = contact_factor(X(), G(), frame, NOISE).error(values_of(lower, [0.1, 0.0, 0.0]))
    here = contact_factor(X(), G(), frame.lifted(0.4), NOISE).error(values_of(pose, [0.1, 0.0, 0.0]))
    assert here == pytest.approx(there)
    assert frame.lifted(0.0) is frame


def test_the_key_has_a_name():
    assert decode_key(G(3)) == ("G", 0, 3)
    assert key_name(G(3)) == "G(t=3)"
