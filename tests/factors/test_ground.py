"""Ground factors: Jacobians, units, and what they pull towards."""

import gtsam
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from factors.ground import GroundRows
from factors.keypoint_rows import KeypointRows
from factors.keys import X
from factors.observation_rows import ObservationRows, term_factor
from factors.projection_kernel import ProjectionKernel
from factors.shape import LinearShape
from tests.factors.support import CAMERA, assert_jacobian, graph_of, optimize, random_pose

DOWN = np.array([0.0, 1.0, 0.0])


def ground_factor(normal, distance, height_sigma=1.0, tilt_sigma=1.0):
    """The ground's rows alone, of a shape that is one point."""
    kernel = ProjectionKernel(LinearShape(np.zeros((1, 3)), np.zeros((0, 1, 3)), np.zeros(0)), CAMERA, X())
    keypoints = KeypointRows(np.zeros((1, 2)), np.ones((1, 3)))
    ground = GroundRows(normal, distance, tilt_sigma)
    return term_factor(ObservationRows(kernel, keypoints, ground=ground, height_sigma=height_sigma), "ground")


def values_of(pose):
    values = gtsam.Values()
    values.insert(X(), pose)
    return values


@settings(deadline=None, derandomize=True, max_examples=20)
@given(st.integers(0, 2**32 - 1))
def test_jacobians(seed):
    rng = np.random.default_rng(seed)
    values = values_of(random_pose(rng))
    normal = rng.normal(size=3)
    assert_jacobian(ground_factor(normal / np.linalg.norm(normal), 1.65), values)


def test_height_is_in_metres():
    values = values_of(gtsam.Pose3(gtsam.Rot3(), np.array([1.0, 2.0, 10.0])))
    assert ground_factor(DOWN, 1.65).unwhitenedError(values)[0] == pytest.approx(0.35)


@pytest.mark.parametrize("lean", [0.001, 0.05, np.pi])
def test_lean(lean):
    values = values_of(gtsam.Pose3(gtsam.Rot3.Rx(lean) * gtsam.Rot3.Ry(1.0), np.array([0.0, 0.0, 9.0])))
    residual = ground_factor(DOWN, 1.65).unwhitenedError(values)[1:]
    assert np.linalg.norm(residual) == pytest.approx(2 * np.sin(lean / 2))


def test_sets_a_leaning_vehicle_upright_on_the_ground():
    normal = np.array([0.05, 1.0, -0.1])
    normal /= np.linalg.norm(normal)
    start = gtsam.Pose3(gtsam.Rot3.Rodrigues(0.5, 2.0, -0.4), np.array([3.0, 0.0, 20.0]))
    graph = graph_of(
        ground_factor(normal, 1.65, 0.1, 0.03),
        gtsam.PriorFactorPose3(X(), start, gtsam.noiseModel.Isotropic.Sigma(6, 1e3)),
    )
    pose = optimize(graph, values_of(start)).atPose3(X())
    assert normal @ pose.translation() == pytest.approx(1.65, abs=1e-6)
    np.testing.assert_allclose(pose.rotation().matrix()[:, 1], normal, atol=1e-6)
