"""Whatever a callback returns, the process lives and the error says which factor was wrong."""

import gc
import weakref

import gtsam
import numpy as np
import pytest

from factors.errors import FactorCallbackError, InvalidInputError
from factors.guard import guarded_factor


class Returns:
    """A callback that returns what it was given."""

    def __init__(self, residual, jacobian):
        self.result = (residual, jacobian)

    def __call__(self, values, want_jacobian):
        return self.result


def make(callback, **options):
    return guarded_factor("test factor", 1.0, (1, 2), (2, 1), 2, callback, **options)


@pytest.fixture
def values():
    values = gtsam.Values()
    values.insert(1, np.zeros(2))
    values.insert(2, np.zeros(1))
    return values


R, J = np.array([1.0, 2.0]), np.arange(6.0).reshape(2, 3)


def test_good_callback(values):
    linear = make(Returns(R, J)).linearize(values)
    np.testing.assert_array_equal(linear.jacobian()[0], J)
    np.testing.assert_array_equal(linear.jacobian()[1], -R)


@pytest.mark.parametrize(
    "jacobian",
    [
        np.zeros((1, 3)),
        np.zeros((3, 3)),
        np.zeros((2, 2)),
        np.zeros((2, 4)),
        np.zeros((0, 0)),
        np.zeros(6),
        None,
        J.astype(np.float32),
        J.tolist(),
        np.where(J == 5, np.nan, J),
        np.where(J == 5, np.inf, J),
        np.where(J == 5, -np.inf, J),
    ],
    ids=lambda j: f"{getattr(j, 'dtype', type(j).__name__)}-{np.shape(j)}",
)
def test_wrong_jacobians_are_caught(values, jacobian):
    for infinite in (False, True):
        factor = make(Returns(R, jacobian), allow_infinite=infinite)
        with pytest.raises(FactorCallbackError, match="test factor: the Jacobian"):
            factor.linearize(values)


@pytest.mark.parametrize(
    "residual",
    [np.zeros(1), np.zeros(3), np.zeros((2, 1)), 0.0, None, [1.0, 2.0], np.array([1, 2]), np.array([1.0, np.nan])],
    ids=repr,
)
def test_wrong_residuals_are_caught(values, residual):
    for infinite in (False, True):
        factor = make(Returns(residual, J), allow_infinite=infinite)
        for evaluate in (factor.error, factor.linearize):
            with pytest.raises(FactorCallbackError, match="test factor: the residual"):
                evaluate(values)


def test_infinity_only_where_permitted(values):
    residual = np.array([1.0, np.inf])
    with pytest.raises(FactorCallbackError, match="residual is inf at"):
        make(Returns(residual, J)).error(values)
    assert make(Returns(residual, J), allow_infinite=True).error(values) == np.inf


def test_finite_numbers_with_infinite_squares_pass(values):
    factor = make(Returns(R, np.full((2, 3), 1e200)))
    assert factor.linearize(values).jacobian()[0].max() == 1e200


@pytest.mark.parametrize("result", [None, R, (R,), (R, J, J), [R, J]], ids=lambda r: type(r).__name__)
def test_wrong_results_are_caught(values, result):
    factor = make(lambda values, want: result)
    with pytest.raises(FactorCallbackError, match="must return"):
        factor.linearize(values)


@pytest.mark.parametrize("kind", [KeyError, ZeroDivisionError, InvalidInputError, MemoryError])
def test_exceptions_keep_their_type_and_abort_the_optimisation(values, kind):
    def fails(values, want):
        raise kind(*(("field", 1, "Fix it.") if kind is InvalidInputError else ("reason",)))

    graph = gtsam.NonlinearFactorGraph()
    graph.add(make(fails))
    with pytest.raises(kind):
        gtsam.LevenbergMarquardtOptimizer(graph, values, gtsam.LevenbergMarquardtParams()).optimize()


def test_a_failure_during_the_optimisation_aborts_it(values):
    calls = []

    def fails_later(values, want):
        calls.append(want)
        return np.ones(2), J if len(calls) < 3 else np.zeros((7, 1))

    graph = gtsam.NonlinearFactorGraph()
    graph.add(make(fails_later))
    graph.add(gtsam.PriorFactorVector(1, np.ones(2), gtsam.noiseModel.Unit.Create(2)))
    optimizer = gtsam.LevenbergMarquardtOptimizer(graph, values, gtsam.LevenbergMarquardtParams())
    with pytest.raises(FactorCallbackError):
        optimizer.optimize()


@pytest.mark.parametrize(
    ("keys", "dims", "noise"),
    [
        ((), (), 1.0),
        ((1, 1), (2, 2), 1.0),
        ((1, 2), (2,), 1.0),
        ((1,), (0,), 1.0),
        ((1,), (2,), 0.0),
        ((1,), (2,), np.nan),
        ((1,), (2,), gtsam.noiseModel.Unit.Create(3)),
    ],
)
def test_construction_is_checked(keys, dims, noise):
    with pytest.raises(InvalidInputError):
        guarded_factor("test factor", noise, keys, dims, 2, Returns(R, J))


def test_a_callback_is_a_function():
    with pytest.raises(InvalidInputError, match=r"^test factor\.callback: got None"):
        guarded_factor("test factor", 1.0, [1], [1], 1, None)


def test_no_leak(values):
    """Neither callbacks nor factors outlive their graph, without help of the garbage collector."""
    gc.collect()
    gc.disable()
    try:
        alive = []
        for _ in range(20):
            graph = gtsam.NonlinearFactorGraph()
            for _ in range(100):
                callback = Returns(R.copy(), J)
                alive.append(weakref.ref(callback))
                graph.add(make(callback))
            graph.error(values)
            graph.linearize(values)
        del graph, callback
        assert not any(ref() is not None for ref in alive)
    finally:
        gc.enable()
