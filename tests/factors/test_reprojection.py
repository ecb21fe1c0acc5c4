"""Reprojection factors: Jacobians in every combination of variables, and solves that recover the truth."""

import gtsam
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from factors.errors import InvalidInputError
from factors.kernel import ProjectionKernel
from factors.keys import L, O, X
from factors.noise import keypoint_noise
from factors.reprojection import reprojection_factor, reprojection_factors, stacked_reprojection_factor
from factors.shape import LinearShape
from factors.shape_prior import coefficients_prior
from tests.factors.support import (
    CAMERA,
    assert_jacobian,
    bound_shape,
    car_like,
    graph_of,
    jacobian,
    optimize,
    project,
    random_pose,
)

seeds = st.integers(0, 2**32 - 1)


def random_values(rng, mean, basis):
    values = gtsam.Values()
    values.insert(X(), random_pose(rng))
    values.insert(L(), rng.normal(size=len(basis)))
    values.insert(O(), 0.05 * rng.normal(size=3 * len(mean)))
    return values


def variants(rng, mean, basis, values):
    """A kernel for every combination of what is a variable."""
    pose, coefficients = values.atPose3(X()), values.atVector(L())
    offsets = values.atVector(O()).reshape(-1, 3)
    for p in (X(), pose):
        for c in (L(), coefficients):
            for o in (O(), offsets, None):
                kernel = ProjectionKernel(LinearShape(mean, basis, c, o), CAMERA, p)
                if kernel.keys:
                    yield kernel


@settings(deadline=None, derandomize=True, max_examples=8)
@given(seeds)
def test_jacobians(seed):
    rng = np.random.default_rng(seed)
    mean, basis = car_like(rng)
    values = random_values(rng, mean, basis)
    for kernel in variants(rng, mean, basis, values):
        i = int(rng.integers(14))
        assert_jacobian(reprojection_factor(kernel, i, rng.uniform(0, 1000, 2), 1.0), values)
        assert_jacobian(
            stacked_reprojection_factor(kernel, [3, 0, i + 14 if i in (0, 3) else i][:2], np.zeros((2, 2)), 1.0), values
        )


def test_jacobians_of_36_points_and_42_vectors():
    rng = np.random.default_rng(0)
    for with_offsets in (False, True):
        shape, values = bound_shape(rng, 36, 42, with_offsets)
        values.insert(X(), random_pose(rng))
        for pose in (X(), values.atPose3(X())):
            factor = stacked_reprojection_factor(
                ProjectionKernel(shape, CAMERA, pose), range(36), np.zeros((36, 2)), 1.0
            )
            assert_jacobian(factor, values)


def test_thin_factors_are_the_rows_of_the_stacked_one():
    rng = np.random.default_rng(1)
    shape, values = bound_shape(rng)
    values.insert(X(), random_pose(rng))
    pixels = rng.uniform(0, 500, (14, 2))
    kernel = ProjectionKernel(shape, CAMERA, X())
    stacked = stacked_reprojection_factor(kernel, range(14), pixels, 1.0)
    thin = reprojection_factors(kernel, pixels, [1.0] * 14)
    np.testing.assert_array_equal(np.vstack([jacobian(f, values) for f in thin]), jacobian(stacked, values))
    assert sum(f.error(values) for f in thin) == pytest.approx(stacked.error(values))


def test_missing_keypoints_get_no_factor():
    shape, values = bound_shape(np.random.default_rng(2))
    values.insert(X(), random_pose(np.random.default_rng(2)))
    pixels = np.zeros((14, 2))
    pixels[3] = np.nan
    kernel = ProjectionKernel(shape, CAMERA, X())
    noises = [keypoint_noise(weight, 2.0) for weight in [0.0, *[1.0] * 13]]
    assert len(reprojection_factors(kernel, pixels, noises)) == 12


def test_recovers_pose_and_shape():
    rng = np.random.default_rng(3)
    mean, basis = car_like(rng)
    truth, pose = rng.normal(size=5), random_pose(rng)
    pixels = project(mean + np.tensordot(truth, basis, axes=1), pose)
    kernel = ProjectionKernel(LinearShape(mean, basis, L()), CAMERA, X())
    graph = graph_of(*reprojection_factors(kernel, pixels, [1e-3] * 14), coefficients_prior(L(), 5, 1e3))
    values = gtsam.Values()
    values.insert(X(), pose.retract(np.array([0.05, -0.05, 0.1, 0.3, 0.2, 0.5])))
    values.insert(L(), np.zeros(5))
    result = optimize(graph, values)
    np.testing.assert_allclose(result.atVector(L()), truth, atol=1e-5)
    assert result.atPose3(X()).equals(pose, 1e-5)


@pytest.mark.parametrize(
    "call",
    [
        lambda k: reprojection_factor(k, 14, [0, 0], 1.0),
        lambda k: reprojection_factor(k, -1, [0, 0], 1.0),
        lambda k: reprojection_factor(k, 0, [0, np.nan], 1.0),
        lambda k: reprojection_factor(k, 0, [0, 0], gtsam.noiseModel.Unit.Create(3)),
        lambda k: reprojection_factors(k, np.zeros((13, 2)), [1.0] * 13),
        lambda k: stacked_reprojection_factor(k, [0, 0], np.zeros((2, 2)), 1.0),
        lambda k: stacked_reprojection_factor(k, [], np.zeros((0, 2)), 1.0),
        lambda k: stacked_reprojection_factor(k, [0, 14], np.zeros((2, 2)), 1.0),
        lambda k: stacked_reprojection_factor(k, [0.5], np.zeros((1, 2)), 1.0),
    ],
)
def test_bad_input(call):
    shape = LinearShape(*car_like(np.random.default_rng(4)), L())
    with pytest.raises(InvalidInputError):
        call(ProjectionKernel(shape, CAMERA, X()))


def test_nothing_variable():
    shape = LinearShape(*car_like(np.random.default_rng(4)), np.zeros(5))
    with pytest.raises(InvalidInputError):
        reprojection_factor(ProjectionKernel(shape, CAMERA, gtsam.Pose3()), 0, [0, 0], 1.0)
