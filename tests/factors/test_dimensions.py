"""Dimension prior: Jacobian, and a solve that reaches the wanted size."""

import numpy as np
import pytest

from factors.dimensions import dimensions_factor
from factors.errors import InvalidInputError
from factors.keys import L, O
from factors.shape_prior import coefficients_prior, offsets_prior
from tests.factors.support import assert_jacobian, bound_shape, graph_of, optimize


def operator(rng, keypoints=14):
    return rng.normal(size=(3, keypoints, 3)) / keypoints


@pytest.mark.parametrize("with_offsets", [False, True])
def test_jacobian(with_offsets):
    rng = np.random.default_rng(0)
    shape, values = bound_shape(rng, with_offsets=with_offsets)
    D = operator(rng)
    factor = dimensions_factor(shape, D, [4, 1.6, 1.5], [1, 1, 1])
    assert_jacobian(factor, values)
    size = np.tensordot(D, shape.points(values), axes=2)
    np.testing.assert_allclose(factor.unwhitenedError(values), size - [4, 1.6, 1.5])


def test_reaches_the_size():
    rng = np.random.default_rng(1)
    shape, values = bound_shape(rng, with_offsets=True)
    D = operator(rng)
    size = np.tensordot(D, shape.mean, axes=2) + np.array([0.2, -0.1, 0.05])
    graph = graph_of(
        dimensions_factor(shape, D, size, [1e-4] * 3), coefficients_prior(L(), 5), offsets_prior(O(), np.full(14, 0.05))
    )
    result = optimize(graph, values)
    np.testing.assert_allclose(np.tensordot(D, shape.points(result), axes=2), size, atol=1e-4)


@pytest.mark.parametrize(
    "change",
    [
        {"operator": np.zeros((3, 13, 3))},
        {"size": [4, 1.6]},
        {"size": [4, 1.6, np.nan]},
        {"sigmas": [1, 1, 0]},
    ],
)
def test_bad_input(change):
    rng = np.random.default_rng(2)
    shape, _ = bound_shape(rng)
    with pytest.raises(InvalidInputError):
        dimensions_factor(shape, **{"operator": operator(rng), "size": [4, 1.6, 1.5], "sigmas": [1, 1, 1], **change})
