"""Levenberg-Marquardt on a graph: minima, iterates, and failures with a type."""

import gtsam
import numpy as np
import pytest

import factors
from factors import L, X
from fgrecon.core.errors import DegenerateProblemError, FactorCallbackError
from fgrecon.solve.graph.graph_settings import SETTINGS
from fgrecon.solve.graph.solver import minimise


def quadratic(matrix, target):
    """A graph with the energy |A x - b|^2 / 2 and its start at zero."""
    graph = gtsam.NonlinearFactorGraph()

    def callback(values, want_jacobian):
        return matrix @ values.atVector(L()) - target, matrix if want_jacobian else None

    graph.add(factors.guarded_factor("quadratic", 1.0, (L(),), (matrix.shape[1],), len(matrix), callback))
    values = gtsam.Values()
    values.insert(L(), np.zeros(matrix.shape[1]))
    return graph, values


def curved():
    """Rosenbrock's valley as least squares."""
    graph = gtsam.NonlinearFactorGraph()

    def callback(values, want_jacobian):
        x, y = values.atVector(L())
        jacobian = np.array([[-20.0 * x, 10.0], [-1.0, 0.0]])
        return np.array([10.0 * (y - x * x), 1.0 - x]), jacobian if want_jacobian else None

    graph.add(factors.guarded_factor("valley", 1.0, (L(),), (2,), 2, callback))
    values = gtsam.Values()
    values.insert(L(), np.array([-1.2, 1.0]))
    return graph, values


def test_a_linear_problem_has_its_closed_form():
    rng = np.random.default_rng(0)
    matrix, target = rng.normal(size=(9, 4)), rng.normal(size=9)
    graph, start = quadratic(matrix, target)
    solution = minimise(graph, start, relative_tolerance=1e-15)
    expected, residual, *_ = np.linalg.lstsq(matrix, target)
    np.testing.assert_allclose(solution.values.atVector(L()), expected, atol=1e-8)
    assert solution.error == pytest.approx(0.5 * residual[0])
    np.testing.assert_array_equal(start.atVector(L()), np.zeros(4))  # the start is not changed


def test_every_iterate_is_recorded():
    graph, start = curved()
    solution = minimise(graph, start, record=True, max_iterations=100, relative_tolerance=1e-14)
    np.testing.assert_allclose(solution.values.atVector(L()), 1.0, atol=1e-6)
    errors = [graph.error(values) for values in solution.path]
    assert len(errors) == solution.iterations > 5
    assert errors == sorted(errors, reverse=True)
    assert len({values.atVector(L()).tobytes() for values in solution.path}) > 5  # copies, not one and the same
    np.testing.assert_array_equal(solution.path[-1].atVector(L()), solution.values.atVector(L()))
    silent = minimise(graph, start, max_iterations=100, relative_tolerance=1e-14)
    assert silent.path == ()
    assert silent.values.atVector(L()).tobytes() == solution.values.atVector(L()).tobytes()


def test_the_limit_of_iterations_holds():
    graph, start = curved()
    stopped = minimise(graph, start, max_iterations=3)
    assert stopped.iterations == 3
    assert not stopped.converged
    assert minimise(graph, start, max_iterations=100).converged


def test_a_step_goes_on_with_the_damping_of_the_one_before():
    graph, start = curved()
    whole = minimise(graph, start, max_iterations=8, relative_tolerance=1e-14)
    values, damping = start, SETTINGS.first_damping
    for _ in range(8):
        step = minimise(graph, values, max_iterations=1, damping=damping)
        values, damping = step.values, step.damping
    np.testing.assert_allclose(values.atVector(L()), whole.values.atVector(L()), atol=1e-12)
    assert damping == pytest.approx(whole.damping)


def test_nothing_to_solve_is_solved():
    solution = minimise(gtsam.NonlinearFactorGraph(), gtsam.Values(), record=True)
    assert solution.values.empty()
    assert (solution.path, solution.error, solution.iterations) == ((), 0.0, 0)


def test_an_infinite_start_is_refused():
    """GTSAM would return it unchanged and say nothing."""
    shape = factors.LinearShape(np.eye(3), np.zeros((1, 3, 3)), L())
    kernel = factors.ProjectionKernel(shape, np.eye(3), X())
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    behind = factors.reprojection_factor(kernel, np.zeros((3, 2)), np.ones(3), np.tile(np.eye(2), (3, 1, 1)))
    for factor in (behind, factors.coefficients_prior(L(), 1)):
        graph.add(factor)
    values.insert(X(), gtsam.Pose3(gtsam.Rot3(), np.array([0.0, 0.0, -5.0])))
    values.insert(L(), np.ones(1))
    with pytest.raises(DegenerateProblemError, match="energy inf"):
        minimise(graph, values)


def test_what_nothing_determines_stays_where_it_is():
    graph, start = quadratic(np.array([[1.0, 0.0]]), np.ones(1))
    start.update(L(), np.array([5.0, 7.0]))
    np.testing.assert_allclose(minimise(graph, start).values.atVector(L()), [1.0, 7.0], atol=1e-6)


def test_errors_of_callbacks_keep_their_type():
    graph = gtsam.NonlinearFactorGraph()
    wrong = factors.guarded_factor("wrong", 1.0, (L(),), (2,), 2, lambda *_: (np.zeros(3), np.zeros((2, 2))))
    graph.add(wrong)
    values = gtsam.Values()
    values.insert(L(), np.zeros(2))
    with pytest.raises(FactorCallbackError, match="wrong"):
        minimise(graph, values)
