"""The Laplacian term in its four forms."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from factors.errors import InvalidInputError
from factors.keys import L
from factors.laplacian import laplacian_factor
from factors.shape import LinearShape
from tests.factors.support import assert_jacobian, bound_shape, jacobian


def ring(keypoints):
    """Neighbourhoods of two or three keypoints; the last keypoint has none."""
    return [
        [(i + 1) % keypoints, (i + 5) % keypoints, (i + 3) % keypoints][: 2 + i % 2] for i in range(keypoints - 1)
    ] + [[]]


def plain(points, neighbours, normalised):
    """The formula keypoint by keypoint."""
    rows = []
    for i, near in enumerate(neighbours):
        if near:
            w = np.array([np.exp(-np.sum((points[i] - points[j]) ** 2)) for j in near])
            if normalised:
                w = w / w.sum()
            rows.append(points[i] - w @ points[near])
    return np.array(rows)


@settings(deadline=None, derandomize=True, max_examples=6)
@given(st.integers(0, 2**32 - 1), st.booleans(), st.booleans(), st.booleans())
def test_value_and_jacobian(seed, with_offsets, normalised, relative):
    shape, values = bound_shape(np.random.default_rng(seed), with_offsets=with_offsets)
    near = ring(14)
    factor = laplacian_factor(shape, near, 1.0, normalised=normalised, relative_to_mean=relative)
    expected = plain(shape.points(values), near, normalised)
    if relative:
        expected = expected - plain(shape.mean, near, normalised)
    np.testing.assert_allclose(factor.unwhitenedError(values), expected.ravel(), atol=1e-12)
    assert_jacobian(factor, values)


def test_36_points_and_42_vectors():
    shape, values = bound_shape(np.random.default_rng(0), 36, 42)
    assert_jacobian(laplacian_factor(shape, ring(36), 1.0), values)


def shifted(shape, by):
    return LinearShape(shape.mean + by, shape.basis, L())


@pytest.mark.parametrize("normalised", [True, False])
def test_only_the_normalised_form_ignores_the_origin(normalised):
    shape, values = bound_shape(np.random.default_rng(1))
    errors = [
        laplacian_factor(s, ring(14), 1.0, normalised=normalised, relative_to_mean=False).unwhitenedError(values)
        for s in (shape, shifted(shape, [1.0, -2.0, 0.5]))
    ]
    assert np.allclose(*errors) == normalised


def test_relative_form_vanishes_at_the_mean_and_the_plain_one_shrinks():
    shape, values = bound_shape(np.random.default_rng(2))
    values.update(L(), np.zeros(5))
    assert laplacian_factor(shape, ring(14), 1.0).error(values) == pytest.approx(0, abs=1e-25)
    collapsed = LinearShape(np.ones((14, 3)), np.zeros((5, 14, 3)), L())
    assert laplacian_factor(collapsed, ring(14), 1.0, relative_to_mean=False).error(values) == 0.0
    assert laplacian_factor(shape, ring(14), 1.0, relative_to_mean=False).error(values) > 1.0


def test_distant_neighbours_do_not_underflow():
    shape, values = bound_shape(np.random.default_rng(3))
    far = LinearShape(shape.mean * 100, shape.basis, L())
    factor = laplacian_factor(far, ring(14), 1.0, relative_to_mean=False)
    assert np.isfinite(factor.unwhitenedError(values)).all()
    assert np.isfinite(jacobian(factor, values)).all()


@pytest.mark.parametrize(
    "near", [ring(13), [[]] * 14, [[0], *[[]] * 13], [[1, 1], *[[]] * 13], [[14], *[[]] * 13], [[0.5], *[[]] * 13]]
)
def test_bad_input(near):
    shape, _ = bound_shape(np.random.default_rng(4))
    with pytest.raises(InvalidInputError):
        laplacian_factor(shape, near, 1.0)
