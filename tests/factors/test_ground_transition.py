"""The ground from one image to the next: derivatives, planes carried along with the camera, and what a chain says."""

import gtsam
import numpy as np
import pytest

from factors import ground_transition_factor, marginal
from factors.contact import GroundFrame
from factors.errors import InvalidInputError
from factors.keys import G
from tests.factors.support import assert_jacobian

NOISE = gtsam.noiseModel.Diagonal.Sigmas(np.array([0.03, 0.004, 0.006]))
CAMERA = gtsam.Pose3(gtsam.Rot3.RzRyRx(0.01, -0.05, 0.02), np.array([0.1, 0.02, 1.3]))
LEVEL, TILTED = GroundFrame.of([0.0, 1.0, 0.0], 1.65), GroundFrame.of([0.02, 1.0, -0.05], 1.4)


def values_of(now, then):
    values = gtsam.Values()
    values.insert(G(0), np.asarray(now, dtype=float))
    values.insert(G(1), np.asarray(then, dtype=float))
    return values


@pytest.mark.parametrize("camera", [None, CAMERA], ids=["unknown", "moving"])
@pytest.mark.parametrize("frames", [(LEVEL, LEVEL), (LEVEL, TILTED), (TILTED, LEVEL)])
def test_jacobian(camera, frames):
    rng = np.random.default_rng(0)
    factor = ground_transition_factor(G(0), G(1), frames, NOISE, camera, kept=0.9)
    for _ in range(5):
        assert_jacobian(factor, values_of(*(rng.normal(size=(2, 3)) * [0.2, 0.05, 0.05])))


@pytest.mark.parametrize("frames", [(LEVEL, LEVEL), (LEVEL, TILTED), (TILTED, LEVEL)])
def test_the_plane_is_the_same_seen_from_the_next_camera(frames):
    """Points of the plane now lie, seen from the camera then, on the plane at which the factor has no residual."""
    now = np.array([0.1, 0.02, -0.03])
    factor = ground_transition_factor(G(0), G(1), frames, NOISE, CAMERA)
    then = -factor.unwhitenedError(values_of(now, np.zeros(3)))
    normal, distance = frames[0].plane(now)
    across = np.linalg.svd(normal[None])[2][1:]
    points = distance * normal + np.array([[0.0, 0.0], [5.0, -3.0], [-2.0, 30.0]]) @ across
    seen = np.array([CAMERA.transformTo(point) for point in points])
    normal, distance = frames[1].plane(then)
    np.testing.assert_allclose(seen @ normal, distance, atol=1e-12)


def test_without_the_cameras_motion_the_deviation_stays_as_far_as_it_is_kept():
    now = np.array([0.1, 0.02, -0.03])
    factor = ground_transition_factor(G(0), G(1), (LEVEL, LEVEL), NOISE, kept=0.8)
    assert factor.error(values_of(now, 0.8 * now)) == pytest.approx(0.0, abs=1e-15)


def test_what_leaves_the_chain_is_as_sure_as_the_sum_of_variances():
    graph, values = gtsam.NonlinearFactorGraph(), values_of(np.zeros(3), np.zeros(3))
    graph.add(gtsam.PriorFactorVector(G(0), np.full(3, 0.01), gtsam.noiseModel.Isotropic.Sigma(3, 0.05)))
    graph.add(ground_transition_factor(G(0), G(1), (LEVEL, LEVEL), NOISE, kept=0.9))
    left = marginal(graph, values, [G(0)])
    covariance = np.linalg.inv(left.matrix.T @ left.matrix)
    np.testing.assert_allclose(covariance, np.diag((0.9 * 0.05) ** 2 + NOISE.sigmas() ** 2), rtol=1e-6)
    np.testing.assert_allclose(covariance @ left.matrix.T @ left.right, np.full(3, 0.009), rtol=1e-6)


@pytest.mark.parametrize("kept", [0.0, 1.1, np.nan])
def test_a_share_is_a_share(kept):
    with pytest.raises(InvalidInputError, match=r"ground_transition\.kept"):
        ground_transition_factor(G(0), G(1), (LEVEL, LEVEL), NOISE, kept=kept)
