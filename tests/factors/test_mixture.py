"""Right or wrong: the loss against its definition, and the forms in which a solver gets it."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from factors.mixture import STIFFEST, Form, mixture, robust_rows

DENSITY = st.floats(1e-3, 10.0)


@given(DENSITY, DENSITY, st.floats(0.0, 60.0))
def test_the_loss_is_the_logarithm_of_the_likelihood_and_the_weight_its_derivative(right, wrong, square):
    squares = np.array([square, square + 1e-6])
    weights, losses = mixture(np.full(2, right), np.full(2, wrong), squares)
    expected = -np.log((right * np.exp(-squares / 2) + wrong) / (right + wrong))
    np.testing.assert_allclose(losses, expected, atol=1e-12)
    assert weights.mean() == pytest.approx(2.0 * (losses[1] - losses[0]) / 1e-6, abs=1e-5)


def test_what_was_not_seen_says_nothing_and_what_cannot_be_wrong_is_least_squares():
    squares = np.array([4.0, 4.0, 2000.0])
    weights, losses = mixture(np.array([0.0, 0.7, 0.7]), np.array([1.0, 0.0, 0.1]), squares)
    np.testing.assert_allclose(weights, [0.0, 1.0, 0.0])
    np.testing.assert_allclose(losses, [0.0, 2.0, np.log(8.0)])


def rows_of(seed, points=6, width=2, columns=4):
    rng = np.random.default_rng(seed)
    residual = rng.normal(size=(points, width)) * rng.uniform(0, 3, (points, 1))
    jacobian = rng.normal(size=(points, width, columns))
    return rng.uniform(0.1, 1, points), rng.uniform(0.01, 0.5, points), residual, jacobian


@pytest.mark.parametrize("width", [1, 2])
@pytest.mark.parametrize("seed", range(5))
def test_the_forms_have_one_gradient_and_newtons_has_the_curvature(seed, width):
    """Against numeric derivatives of the loss itself, the residual taken as linear."""
    right, wrong, residual, jacobian = rows_of(seed, width=width)

    def losses(x):
        return mixture(right, wrong, np.square(residual + jacobian @ x).sum(axis=1))[1]

    step = 1e-4
    axes = step * np.eye(4)
    gradient = np.array([(losses(a) - losses(-a)) / (2 * step) for a in axes]).T
    hessian = np.array(
        [[(losses(a + b) - losses(a - b) - losses(b - a) + losses(-a - b)) / (4 * step**2) for a in axes] for b in axes]
    ).transpose(2, 0, 1)
    weights, loss = mixture(right, wrong, np.square(residual).sum(axis=1))
    weighted, by_weighted = robust_rows(Form.WEIGHTED, weights, wrong, residual, jacobian)
    newton, by_newton = robust_rows(Form.NEWTON, right, wrong, residual, jacobian)
    above, by_above = robust_rows(Form.MAJORISED, right, wrong, residual, jacobian)
    only, nothing = robust_rows(Form.LOSS, right, wrong, residual, None)
    assert nothing is None
    np.testing.assert_allclose(0.5 * np.square(only).sum(axis=1), loss, atol=1e-12)
    for rows, by in ((weighted, by_weighted), (newton, by_newton), (above, by_above)):
        np.testing.assert_allclose((by.transpose(0, 2, 1) @ rows[..., None])[..., 0], gradient, atol=1e-6)
    stiff = 1.0 - (1.0 - weights) * np.square(residual).sum(axis=1) > STIFFEST
    curvature = by_newton.transpose(0, 2, 1) @ by_newton
    assert stiff.any()
    np.testing.assert_allclose(curvature[stiff], hessian[stiff], atol=1e-5)
    assert (np.linalg.eigvalsh(curvature) > -1e-12).all()


@given(st.integers(0, 2**32 - 1))
def test_the_majorised_rows_parabola_lies_nowhere_below_the_loss(seed):
    right, wrong, residual, jacobian = rows_of(seed)
    rows, by = robust_rows(Form.MAJORISED, right, wrong, residual, jacobian)
    here = mixture(right, wrong, np.square(residual).sum(axis=1))[1]
    x = np.random.default_rng(seed + 1).normal(size=4) * 3.0
    there = mixture(right, wrong, np.square(residual + jacobian @ x).sum(axis=1))[1]
    rise = 0.5 * (np.square(rows + by @ x).sum(axis=1) - np.square(rows).sum(axis=1))
    assert (there <= here + rise + 1e-9).all()


def test_a_residual_of_zero_is_no_division_by_it():
    right, wrong, _, jacobian = rows_of(0)
    for form in Form:
        rows, by = robust_rows(form, right, wrong, np.zeros((6, 2)), jacobian)
        assert not rows.any()
        assert np.isfinite(by).all()
