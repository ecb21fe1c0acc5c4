"""Ground factors: Jacobians, units, and what they pull towards."""

import gtsam
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from factors.errors import InvalidInputError
from factors.ground import ground_height_factor, upright_factor
from factors.keys import X
from tests.factors.support import assert_jacobian, graph_of, optimize, random_pose

DOWN = np.array([0.0, 1.0, 0.0])


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
    assert_jacobian(ground_height_factor(X(), normal, 1.65, 1.0), values)
    assert_jacobian(upright_factor(X(), normal, 1.0), values)


def test_height_is_in_metres_whatever_the_length_of_the_normal():
    values = values_of(gtsam.Pose3(gtsam.Rot3(), np.array([1.0, 2.0, 10.0])))
    assert ground_height_factor(X(), 3 * DOWN, 1.65, 1.0).unwhitenedError(values) == pytest.approx([0.35])


@pytest.mark.parametrize("lean", [0.001, 0.05, np.pi])
def test_lean(lean):
    values = values_of(gtsam.Pose3(gtsam.Rot3.Rx(lean) * gtsam.Rot3.Ry(1.0), np.zeros(3)))
    residual = upright_factor(X(), DOWN, 1.0).unwhitenedError(values)
    assert np.linalg.norm(residual) == pytest.approx(2 * np.sin(lean / 2))


def test_sets_a_leaning_vehicle_upright_on_the_ground():
    normal = np.array([0.05, 1.0, -0.1])
    normal /= np.linalg.norm(normal)
    start = gtsam.Pose3(gtsam.Rot3.Rodrigues(0.5, 2.0, -0.4), np.array([3.0, 0.0, 20.0]))
    graph = graph_of(
        ground_height_factor(X(), normal, 1.65, 0.1),
        upright_factor(X(), normal, 0.03),
        gtsam.PriorFactorPose3(X(), start, gtsam.noiseModel.Isotropic.Sigma(6, 1e3)),
    )
    pose = optimize(graph, values_of(start)).atPose3(X())
    assert normal @ pose.translation() == pytest.approx(1.65, abs=1e-6)
    np.testing.assert_allclose(pose.rotation().matrix()[:, 1], normal, atol=1e-6)


@pytest.mark.parametrize(("normal", "distance"), [(np.zeros(3), 1.0), (DOWN, np.nan), ([0, np.inf, 0], 1.0)])
def test_bad_input(normal, distance):
    with pytest.raises(InvalidInputError):
        ground_height_factor(X(), normal, distance, 1.0)
