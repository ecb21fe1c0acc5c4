"""The acceleration of an iteration: a linear one is solved at once, with and without the compiled kernel."""

import numpy as np
import pytest

from fgrecon.solve.graph.anderson import Anderson


@pytest.fixture(params=["compiled", "numpy"], autouse=True)
def kernel(request, monkeypatch):
    monkeypatch.setenv("FGRECON_KERNEL", "" if request.param == "compiled" else "numpy")


def test_acceleration_solves_a_linear_iteration_at_once():
    """Of x -> A x + b in three dimensions the fixed point is known after four steps."""
    rng = np.random.default_rng(0)
    A, b = 0.3 * rng.normal(size=(3, 3)), rng.normal(size=3)
    fixed = np.linalg.solve(np.eye(3) - A, b)
    steps, x = Anderson(), np.zeros(3)
    for _ in range(5):
        plain = A @ x + b - x
        further = steps.propose(plain)
        step = plain if further is None else further
        steps.took(step)
        x = x + step
    np.testing.assert_allclose(x, fixed, atol=1e-7)


def test_the_mixture_is_that_of_least_squares():
    rng = np.random.default_rng(1)
    steps, made = Anderson(), [0.5**k * rng.normal(size=9) for k in range(6)]
    for step in made:
        further = steps.propose(step)
        steps.took(step)
    changes, moves = np.diff(made, axis=0)[-4:].T, np.array(made[1:5]).T
    share = np.linalg.lstsq(changes, made[-1], rcond=None)[0]
    np.testing.assert_allclose(further, made[-1] - (moves + changes) @ share, atol=1e-6)


def test_steps_that_do_not_change_say_nothing():
    steps = Anderson()
    for _ in range(2):
        further = steps.propose(np.ones(3))
        steps.took(np.ones(3))
    assert further is None
