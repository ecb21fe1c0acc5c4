"""The barrier rejects steps through the camera, whatever the robust loss; a start behind it is refused."""

import gtsam
import numpy as np
import pytest

from factors.errors import DegenerateProblemError
from factors.keys import L, X
from factors.losses import Loss, RobustLoss
from factors.observation_rows import check_in_front, reprojection_factor
from factors.projection_kernel import ProjectionKernel
from factors.shape import LinearShape
from factors.shape_prior import coefficients_prior
from tests.factors.support import CAMERA, bound_shape, car_like, graph_of, project


@pytest.fixture
def problem():
    shape, values = bound_shape(np.random.default_rng(0))
    values.insert(X(), gtsam.Pose3(gtsam.Rot3(), np.array([0.0, 1.0, 10.0])))
    return ProjectionKernel(shape, CAMERA, X()), values


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
    graph = graph_of(
        reprojection_factor(kernel, project(mean, truth), np.ones(14), np.tile(400.0 * np.eye(2), (14, 1, 1)), robust),
        coefficients_prior(L(), 5),
    )
    values = gtsam.Values()
    values.insert(X(), start)
    values.insert(L(), np.zeros(5))
    undamped = values.retract(graph.linearize(values).optimize())
    assert kernel.evaluate(undamped).depths.min() < 0
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
