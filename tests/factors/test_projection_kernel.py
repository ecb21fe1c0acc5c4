"""The projection kernel: agreement with the plain formula, laziness, caching, points behind the camera."""

import gtsam
import numpy as np
import pytest

from factors.errors import InvalidInputError
from factors.keys import L, X
from factors.projection_kernel import ProjectionKernel
from factors.shape import LinearShape
from tests.factors.support import CAMERA, bound_shape, car_like, project, random_pose


@pytest.fixture
def problem():
    rng = np.random.default_rng(0)
    shape, values = bound_shape(rng)
    pose = random_pose(rng)
    values.insert(X(), pose)
    return shape, values, pose


def test_projection(problem):
    shape, values, pose = problem
    expected = project(shape.points(values), pose)
    for kernel in (ProjectionKernel(shape, CAMERA, X()), ProjectionKernel(shape, CAMERA, pose)):
        projection = kernel.evaluate(values)
        np.testing.assert_allclose(projection.pixels, expected, rtol=1e-12)
        depths = (pose.rotation().matrix() @ shape.points(values).T).T[:, 2] + pose.z()
        np.testing.assert_allclose(projection.depths, depths)


def test_evaluated_once_and_never_stale(problem):
    shape, values, pose = problem
    kernel = ProjectionKernel(shape, CAMERA, X())
    first = kernel.evaluate(values)
    assert first.jacobian is None
    assert kernel.evaluate(gtsam.Values(values), jacobian=True) is first
    assert first.jacobian.shape == (14, 2, 11)
    for key, moved in ((X(), pose.retract(np.full(6, 1e-9))), (L(), values.atVector(L()) + 1e-9)):
        changed = gtsam.Values(values)
        changed.update(key, moved)
        second = kernel.evaluate(changed)
        assert second is not first
        assert second.jacobian is None
        assert np.abs(second.pixels - first.pixels).max() > 0
    again = kernel.evaluate(values, jacobian=True)
    np.testing.assert_array_equal(again.jacobian, first.jacobian)


def test_frames_share_a_shape(problem):
    shape, values, pose = problem
    other = pose.retract(np.array([0.1, 0.2, -0.1, 1.0, 0.0, -0.5]))
    values.insert(X(0, 1), other)
    kernels = [ProjectionKernel(shape, CAMERA, X(0, t)) for t in (0, 1)]
    for _ in range(2):
        for kernel, camera_T_object in zip(kernels, (pose, other), strict=True):
            pixels = kernel.evaluate(values, jacobian=True).pixels
            np.testing.assert_allclose(pixels, project(shape.points(values), camera_T_object), rtol=1e-12)


def test_behind_the_camera_stays_finite(problem):
    shape, values, _ = problem
    kernel = ProjectionKernel(shape, CAMERA, X())
    for z in (0.0, -1e-3, -10.0):
        values.update(X(), gtsam.Pose3(gtsam.Rot3(), np.array([0.0, 0.0, z])))
        projection = kernel.evaluate(values, jacobian=True)
        assert projection.depths.min() < 0
        assert np.isfinite(projection.pixels).all()
        assert np.isfinite(projection.jacobian).all()


@pytest.mark.parametrize(
    "camera",
    [
        np.zeros((3, 3)),
        np.diag([700.0, -700.0, 1.0]),
        np.diag([700.0, 700.0, 2.0]),
        CAMERA + np.eye(3)[[1, 0, 2]],
        np.eye(4),
        np.full((3, 3), np.nan),
    ],
)
def test_bad_camera(camera):
    shape = LinearShape(*car_like(np.random.default_rng(1)), L())
    with pytest.raises(InvalidInputError) as error:
        ProjectionKernel(shape, camera, X())
    assert error.value.field == "camera_matrix"


def test_bad_pose():
    shape = LinearShape(*car_like(np.random.default_rng(1)), L())
    with pytest.raises(InvalidInputError) as error:
        ProjectionKernel(shape, CAMERA, gtsam.Pose3(gtsam.Rot3(), np.full(3, np.nan)))
    assert error.value.field == "pose"
