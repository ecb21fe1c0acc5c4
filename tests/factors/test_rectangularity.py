"""Rectangular faces."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from factors.errors import InvalidInputError
from factors.keys import L, O
from factors.rectangularity import rectangularity_factor
from factors.shape_prior import coefficients_prior, offsets_prior
from tests.factors.support import assert_jacobian, bound_shape, graph_of, jacobian, optimize, quad_at

RECTANGLE = np.array([[1.0, 0.3, 0.6], [1.0, 0.3, -0.6], [-1.0, 0.3, -0.6], [-1.0, 0.3, 0.6]])


@settings(deadline=None, derandomize=True, max_examples=8)
@given(st.integers(0, 2**32 - 1), st.booleans())
def test_jacobian(seed, with_offsets):
    shape, values = bound_shape(np.random.default_rng(seed), with_offsets=with_offsets)
    assert_jacobian(rectangularity_factor(shape, [4, 1, 8, 3], 1.0), values)


def moved(*corners, by):
    quad = RECTANGLE.copy()
    quad[list(corners)] += by
    return quad


@pytest.mark.parametrize(
    ("corners", "is_rectangle"),
    [
        (RECTANGLE @ np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0], True),
        (moved(0, 1, by=[0.2, 0, 0]), True),
        (moved(0, 3, by=[0, 0.1, 0.2]), True),
        (moved(0, 3, by=[0.2, 0, 0]), False),  # a parallelogram
        (moved(0, by=[0.2, 0, 0]), False),
        (moved(0, 2, by=[0, 0.2, 0]), False),  # warped
        (RECTANGLE[[0, 2, 1, 3]], False),  # not in order
    ],
)
def test_zero_for_rectangles_alone(corners, is_rectangle):
    shape, values = quad_at(corners)
    residual = rectangularity_factor(shape, [0, 1, 2, 3], 1.0).unwhitenedError(values)
    assert (np.abs(residual).max() < 1e-12) == is_rectangle


def test_makes_a_rectangle():
    shape, values = quad_at(RECTANGLE + 0.1 * np.random.default_rng(1).normal(size=(4, 3)))
    factor = rectangularity_factor(shape, range(4), 1e-4)
    result = optimize(graph_of(factor, coefficients_prior(L(), 3), offsets_prior(O(), np.full(6, 0.2))), values)
    a, b, c, d = shape.points(result)[:4]
    np.testing.assert_allclose(a - b, d - c, atol=1e-5)
    assert (a - b) @ (b - c) == pytest.approx(0, abs=1e-5)
    assert np.linalg.norm(a - b) > 0.8


def test_a_collapsed_face_stays_finite():
    shape, values = quad_at(np.zeros((4, 3)))
    factor = rectangularity_factor(shape, range(4), 1.0)
    assert not factor.unwhitenedError(values).any()
    assert np.isfinite(jacobian(factor, values)).all()


@pytest.mark.parametrize("quad", [[0, 1, 2], [0, 1, 2, 2], [0, 1, 2, 3, 4], [0, 1, 2, 14]])
def test_bad_input(quad):
    shape, _ = bound_shape(np.random.default_rng(1))
    with pytest.raises(InvalidInputError):
        rectangularity_factor(shape, quad, 1.0)
