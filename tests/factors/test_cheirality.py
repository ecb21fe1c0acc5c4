"""The barrier rejects steps through the camera, whatever the robust loss; a start behind it is refused."""

import gtsam
import numpy as np
import pytest

from factors.cheirality import check_in_front, cheirality_factor
from factors.errors import DegenerateProblemError
from factors.kernel import ProjectionKernel
from factors.keys import L, X
from factors.losses import Loss, RobustLoss
from factors.noise import keypoint_noise
from factors.reprojection import reprojection_factors
from factors.shape import LinearShape
from factors.shape_prior import coefficients_prior
from tests.factors.support import CAMERA, bound_shape, car_like, graph_of, project


@pytest.fixture
def problem():
    shape, values = bound_shape(np.random.default_rng(0))
    values.insert(X(), gtsam.Pose3(gtsam.Rot3(), np.array([0.0, 1.0, 10.0])))
    return ProjectionKernel(shape, CAMERA, X()), values


def test_barrier(problem):
    kernel, values = problem
    factor = cheirality_factor(kernel)
    assert factor.error(values) == 0
    A, b = factor.linearize(values).jacobian()
    assert A.shape == (1, 11)
    assert not A.any()
    assert not b.any()
    values.update(X(), gtsam.Pose3(gtsam.Rot3(), np.array([0.0, 1.0, 0.0])))
    assert factor.error(values) == np.inf


def test_start_behind_the_camera_is_refused(problem):
    kernel, values = problem
    check_in_front(kernel, values)
    values.update(X(), gtsam.Pose3(gtsam.Rot3(), np.array([0.0, 1.0, -10.0])))
    with pytest.raises(DegenerateProblemError, match="behind the camera"):
        check_in_front(kernel, values)
    values.update(X(), gtsam.Pose3(gtsam.Rot3(), np.full(3, np.nan)))
    with pytest.raises(DegenerateProblemError):
        check_in_front(kernel, values)


@pytest.mark.parametrize("loss", [None, *Loss])
def test_steps_behind_the_camera_are_rejected(loss):
    """A start four times too far away: the undamped step leads through the camera."""
    mean, basis = car_like(np.random.default_rng(1))
    truth = gtsam.Pose3(gtsam.Rot3.Ry(0.3), np.array([0.5, 1.0, 5.0]))
    start = gtsam.Pose3(gtsam.Rot3.Ry(0.4), np.array([2.0, 4.0, 20.0]))
    robust = None if loss is None else RobustLoss(loss, 20.0)
    kernel = ProjectionKernel(LinearShape(mean, basis, L()), CAMERA, X())
    thin = reprojection_factors(kernel, project(mean, truth), [keypoint_noise(1.0, 20.0, robust=robust)] * 14)
    values = gtsam.Values()
    values.insert(X(), start)
    values.insert(L(), np.zeros(5))
    without = graph_of(*thin, coefficients_prior(L(), 5))
    undamped = values.retract(without.linearize(values).optimize())
    assert kernel.evaluate(undamped).depths.min() < 0
    assert np.isfinite(without.error(undamped))

    graph = graph_of(*thin, coefficients_prior(L(), 5), cheirality_factor(kernel))
    assert graph.error(undamped) == np.inf
    accepted = []
    params = gtsam.LevenbergMarquardtParams()
    params.setlambdaInitial(1e-9)
    optimizer = None
    params.iterationHook = lambda *_: accepted.append(kernel.evaluate(optimizer.values()).depths.min() > 0)
    optimizer = gtsam.LevenbergMarquardtOptimizer(graph, values, params)
    result = optimizer.optimize()
    assert accepted
    assert all(accepted)
    check_in_front(kernel, result)
    assert graph.error(result) < graph.error(values)
