"""Rows of keypoints: Jacobians in every combination of variables, and solves that recover the truth."""

import gtsam
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from factors.errors import InvalidInputError
from factors.guard import guarded_factor
from factors.keypoint_rows import whiteners
from factors.keys import L, O, X
from factors.losses import Loss, RobustLoss
from factors.observation_rows import reprojection_factor
from factors.projection_kernel import ProjectionKernel
from factors.shape import LinearShape
from factors.shape_prior import coefficients_prior
from tests.factors.support import (
    CAMERA,
    assert_jacobian,
    bound_shape,
    car_like,
    graph_of,
    optimize,
    project,
    random_pose,
)

seeds = st.integers(0, 2**32 - 1)
UNIT = np.tile(np.eye(2), (14, 1, 1))


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
        assert_jacobian(reprojection_factor(kernel, np.zeros((14, 2)), rng.uniform(0, 1, 14), UNIT), values)


def test_the_weights_scale_the_energy():
    """That of a keypoint is w d' Sigma^-1 d / 2, without what is left out."""
    rng = np.random.default_rng(8)
    shape, values = bound_shape(rng, 14, 5, with_offsets=False)
    values.insert(X(), random_pose(rng))
    kernel = ProjectionKernel(shape, CAMERA, X())
    pixels, weights = rng.uniform(0, 500, (14, 2)), rng.uniform(0.01, 1, 14)
    pixels[2], weights[7] = np.nan, 0.0
    roots = rng.normal(size=(14, 2, 2))
    covariances = roots @ roots.transpose(0, 2, 1) + 0.1 * np.eye(2)
    factor = reprojection_factor(kernel, pixels, weights, covariances)
    expected = 0.0
    for k in np.delete(np.arange(14), [2, 7]):
        d = kernel.evaluate(values).pixels[k] - pixels[k]
        expected += 0.5 * weights[k] * d @ np.linalg.solve(covariances[k], d)
    assert factor.error(values) == pytest.approx(expected, rel=1e-9)


def test_jacobians_of_36_points_and_42_vectors():
    rng = np.random.default_rng(0)
    for with_offsets in (False, True):
        shape, values = bound_shape(rng, 36, 42, with_offsets)
        values.insert(X(), random_pose(rng))
        for pose in (X(), values.atPose3(X())):
            kernel = ProjectionKernel(shape, CAMERA, pose)
            assert_jacobian(
                reprojection_factor(kernel, np.zeros((36, 2)), np.ones(36), np.tile(np.eye(2), (36, 1, 1))), values
            )


@pytest.mark.parametrize("loss", Loss)
def test_an_m_estimator_is_gtsams_around_each_keypoint(loss):
    """Same energy, same linear system, as GTSAM's robust noise model around each keypoint has them."""
    rng = np.random.default_rng(5)
    robust = RobustLoss.of(loss)
    mean, basis = car_like(rng)
    pose = random_pose(rng)
    kernel = ProjectionKernel(LinearShape(mean, basis, L()), CAMERA, X())
    pixels = project(mean, pose) + rng.normal(size=(14, 2))
    pixels[:3] += 40 * rng.normal(size=(3, 2))
    pixels[6] = np.nan
    roots = rng.normal(size=(14, 2, 2))
    covariances = roots @ roots.transpose(0, 2, 1) + np.eye(2)
    stacked = reprojection_factor(kernel, pixels, np.ones(14), covariances, robust)
    values = gtsam.Values()
    values.insert(X(), pose.retract(np.array([0.02, -0.03, 0.02, 0.1, 0.1, 0.3])))
    values.insert(L(), 0.5 * rng.normal(size=5))
    thin = []
    for k in np.flatnonzero(~np.isnan(pixels[:, 0])):

        def one(at, want, k=k):
            here = kernel.evaluate(at, want)
            return here.pixels[k] - pixels[k], here.jacobian[k] if want else None

        noise = robust.wrap(gtsam.noiseModel.Gaussian.Covariance(covariances[k]))
        thin.append(guarded_factor("one", noise, kernel.keys, kernel.dims, 2, one))
    graphs = [graph_of(*fs, coefficients_prior(L(), 5)) for fs in (thin, [stacked])]
    assert graphs[0].error(values) == pytest.approx(graphs[1].error(values), rel=1e-12)
    ordering = gtsam.Ordering()
    for key in (X(), L()):
        ordering.push_back(key)
    systems = [graph.linearize(values).hessian(ordering) for graph in graphs]
    for a, b in zip(*systems, strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-9 * np.abs(a).max())
    results = [optimize(graph, values) for graph in graphs]
    np.testing.assert_allclose(results[0].atVector(L()), results[1].atVector(L()), atol=1e-5)
    assert results[0].atPose3(X()).equals(results[1].atPose3(X()), 1e-5)


def test_robust_losses_where_every_residual_is_zero():
    shape, values = bound_shape(np.random.default_rng(6))
    values.insert(X(), random_pose(np.random.default_rng(6)))
    kernel = ProjectionKernel(shape, CAMERA, X())
    pixels = kernel.evaluate(values).pixels
    for loss in Loss:
        factor = reprojection_factor(kernel, pixels, np.ones(14), UNIT, RobustLoss.of(loss))
        assert factor.error(values) == 0
        assert_jacobian(factor, values, step=1e-5, relative=1e-5)


def test_whiteners():
    covariances = np.array([np.eye(2), [[4.0, 1.0], [1.0, 2.0]], [[1.0, -0.5], [-0.5, 3.0]]])
    for S in (covariances, np.tile(4 * np.eye(2), (3, 1, 1))):
        for i, (a, b, c) in enumerate(whiteners(S)):
            W = np.array([[a, 0], [b, c]])
            np.testing.assert_allclose(W.T @ W, np.linalg.inv(S[i]), atol=1e-14)


def test_recovers_pose_and_shape():
    rng = np.random.default_rng(3)
    mean, basis = car_like(rng)
    truth, pose = rng.normal(size=5), random_pose(rng)
    pixels = project(mean + np.tensordot(truth, basis, axes=1), pose)
    kernel = ProjectionKernel(LinearShape(mean, basis, L()), CAMERA, X())
    graph = graph_of(reprojection_factor(kernel, pixels, np.ones(14), 1e-6 * UNIT), coefficients_prior(L(), 5, 1e3))
    values = gtsam.Values()
    values.insert(X(), pose.retract(np.array([0.05, -0.05, 0.1, 0.3, 0.2, 0.5])))
    values.insert(L(), np.zeros(5))
    result = optimize(graph, values)
    np.testing.assert_allclose(result.atVector(L()), truth, atol=1e-5)
    assert result.atPose3(X()).equals(pose, 1e-5)


@pytest.mark.parametrize(
    "call",
    [
        lambda k: reprojection_factor(k, np.zeros((13, 2)), np.ones(14), UNIT),
        lambda k: reprojection_factor(k, np.full((14, 2), np.inf), np.ones(14), UNIT),
        lambda k: reprojection_factor(k, np.zeros((14, 2)), np.ones(13), UNIT),
        lambda k: reprojection_factor(k, np.zeros((14, 2)), -np.ones(14), UNIT),
        lambda k: reprojection_factor(k, np.zeros((14, 2)), np.zeros(14), UNIT),
        lambda k: reprojection_factor(k, np.full((14, 2), np.nan), np.ones(14), UNIT),
        lambda k: reprojection_factor(k, np.zeros((14, 2)), np.ones(14), 0.0 * UNIT),
        lambda k: reprojection_factor(k, np.zeros((14, 2)), np.ones(14), UNIT - 2.0 * np.eye(2)),
        lambda k: reprojection_factor(k, np.zeros((14, 2)), np.ones(14), UNIT[:, :1]),
        lambda k: reprojection_factor(k, np.zeros((14, 2)), np.ones(14), np.tile([[1.0, 2.0], [2.0, 1.0]], (14, 1, 1))),
    ],
)
def test_bad_input(call):
    shape = LinearShape(*car_like(np.random.default_rng(4)), L())
    with pytest.raises(InvalidInputError):
        call(ProjectionKernel(shape, CAMERA, X()))


def test_nothing_variable():
    shape = LinearShape(*car_like(np.random.default_rng(4)), np.zeros(5))
    with pytest.raises((InvalidInputError, ValueError)):
        reprojection_factor(ProjectionKernel(shape, CAMERA, gtsam.Pose3()), np.zeros((14, 2)), np.ones(14), UNIT)
