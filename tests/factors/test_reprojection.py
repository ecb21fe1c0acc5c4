"""Reprojection factors: Jacobians in every combination of variables, and solves that recover the truth."""

import gtsam
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from factors.errors import InvalidInputError
from factors.kernel import ProjectionKernel
from factors.keys import L, O, X
from factors.losses import Loss, RobustLoss
from factors.noise import keypoint_noise
from factors.reprojection import (
    reprojection_factor,
    reprojection_factors,
    stacked_reprojection_factor,
)
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
        assert_jacobian(stacked_reprojection_factor(kernel, np.zeros((14, 2)), rng.uniform(0, 1, 14), 1.0), values)


@pytest.mark.parametrize("with_covariances", [False, True])
def test_the_weights_are_in_the_noise_model(with_covariances):
    """Rows are pixels; their covariance is sigma^2 / w, or block by block Sigma_i / w_i, without what is left out."""
    rng = np.random.default_rng(8)
    shape, values = bound_shape(rng, 14, 5, with_offsets=False)
    values.insert(X(), random_pose(rng))
    kernel = ProjectionKernel(shape, CAMERA, X())
    pixels, weights = rng.uniform(0, 500, (14, 2)), rng.uniform(0.01, 1, 14)
    pixels[2], weights[7] = np.nan, 0.0
    roots = rng.normal(size=(14, 2, 2))
    covariances = roots @ roots.transpose(0, 2, 1) + 0.1 * np.eye(2) if with_covariances else None
    factor = stacked_reprojection_factor(kernel, pixels, weights, 3.0, covariances=covariances)
    used = np.delete(np.arange(14), [2, 7])
    each = np.tile(9.0 * np.eye(2), (14, 1, 1)) if covariances is None else covariances
    expected = np.zeros((24, 24))
    for row, k in enumerate(used):
        expected[2 * row : 2 * row + 2, 2 * row : 2 * row + 2] = each[k] / weights[k]
    np.testing.assert_allclose(factor.noiseModel().covariance(), expected, rtol=1e-9, atol=1e-9)
    residual = factor.unwhitenedError(values)
    np.testing.assert_allclose(residual, (kernel.evaluate(values).pixels - pixels)[used].ravel(), rtol=1e-12)
    assert factor.error(values) == pytest.approx(0.5 * residual @ np.linalg.solve(expected, residual), rel=1e-9)


def test_jacobians_of_36_points_and_42_vectors():
    rng = np.random.default_rng(0)
    for with_offsets in (False, True):
        shape, values = bound_shape(rng, 36, 42, with_offsets)
        values.insert(X(), random_pose(rng))
        for pose in (X(), values.atPose3(X())):
            kernel = ProjectionKernel(shape, CAMERA, pose)
            assert_jacobian(stacked_reprojection_factor(kernel, np.zeros((36, 2)), np.ones(36), 1.0), values)


@pytest.mark.parametrize("with_covariances", [False, True])
@pytest.mark.parametrize("loss", [None, *Loss])
def test_stacked_factor_equals_thin_factors(loss, with_covariances):
    """Same energy, same linear system, same optimum."""
    rng = np.random.default_rng(5)
    robust = None if loss is None else RobustLoss.of(loss)
    mean, basis = car_like(rng)
    pose = random_pose(rng)
    kernel = ProjectionKernel(LinearShape(mean, basis, L()), CAMERA, X())
    pixels = project(mean, pose) + rng.normal(size=(14, 2))
    pixels[:3] += 40 * rng.normal(size=(3, 2))
    pixels[6] = np.nan
    weights = rng.uniform(0.2, 1.0, 14)
    weights[9] = 0.0
    roots = rng.normal(size=(14, 2, 2))
    covariances = roots @ roots.transpose(0, 2, 1) + np.eye(2) if with_covariances else None
    noises = [
        keypoint_noise(w, 2.0, covariance=S, robust=robust)
        for w, S in zip(weights, [None] * 14 if covariances is None else covariances, strict=True)
    ]
    thin = reprojection_factors(kernel, pixels, noises)
    stacked = stacked_reprojection_factor(kernel, pixels, weights, 2.0, covariances=covariances, robust=robust)
    assert len(thin) == 12
    assert stacked.dim() == 24
    values = gtsam.Values()
    values.insert(X(), pose.retract(np.array([0.02, -0.03, 0.02, 0.1, 0.1, 0.3])))
    values.insert(L(), 0.5 * rng.normal(size=5))
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
        factor = stacked_reprojection_factor(kernel, pixels, np.ones(14), 1.0, robust=RobustLoss.of(loss))
        assert factor.error(values) == 0
        assert_jacobian(factor, values, step=1e-5, relative=1e-5)


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
        lambda k: stacked_reprojection_factor(k, np.zeros((13, 2)), np.ones(14), 1.0),
        lambda k: stacked_reprojection_factor(k, np.full((14, 2), np.inf), np.ones(14), 1.0),
        lambda k: stacked_reprojection_factor(k, np.zeros((14, 2)), np.ones(13), 1.0),
        lambda k: stacked_reprojection_factor(k, np.zeros((14, 2)), -np.ones(14), 1.0),
        lambda k: stacked_reprojection_factor(k, np.zeros((14, 2)), np.zeros(14), 1.0),
        lambda k: stacked_reprojection_factor(k, np.full((14, 2), np.nan), np.ones(14), 1.0),
        lambda k: stacked_reprojection_factor(k, np.zeros((14, 2)), np.ones(14), 0.0),
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
