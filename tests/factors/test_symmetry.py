"""Symmetry about the medial plane."""

import gtsam
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from factors.errors import InvalidInputError
from factors.keys import L, M, O
from factors.planes import make_plane
from factors.shape import LinearShape
from factors.shape_prior import coefficients_prior, offsets_prior
from factors.symmetry import symmetry_factor
from tests.factors.support import assert_jacobian, bound_shape, car_like, graph_of, optimize, random_plane

PAIRS = [(0, 1), (4, 3), (10, 12)]


@settings(deadline=None, derandomize=True, max_examples=8)
@given(st.integers(0, 2**32 - 1), st.booleans())
def test_jacobian(seed, with_offsets):
    rng = np.random.default_rng(seed)
    shape, values = bound_shape(rng, with_offsets=with_offsets)
    values.insert(M(), random_plane(rng))
    assert_jacobian(symmetry_factor(shape, PAIRS, M(), 1.0), values)
    assert_jacobian(symmetry_factor(shape, PAIRS, M(), 1.0, on_plane=[7, 2]), values)


def mirrored(rng, plane, pairs, middle, keypoints=14, vectors=5):
    """A shape that is symmetric about the plane for every lambda."""
    mean, basis = car_like(rng, keypoints, vectors)
    n, d = plane.planeCoefficients()[:3], plane.planeCoefficients()[3]
    H = np.eye(3) - 2 * np.outer(n, n)
    for left, right in pairs:
        mean[left] = H @ mean[right] - 2 * d * n
        basis[:, left] = basis[:, right] @ H
    for i in middle:
        mean[i] -= (mean[i] @ n + d) * n
        basis[:, i] -= np.outer(basis[:, i] @ n, n)
    return mean, basis


@pytest.mark.parametrize("seed", range(3))
def test_vanishes_for_a_symmetric_prior_whatever_lambda(seed):
    rng = np.random.default_rng(seed)
    plane = random_plane(rng)
    shape = LinearShape(*mirrored(rng, plane, PAIRS, [7, 2]), L())
    values = gtsam.Values()
    values.insert(L(), rng.normal(size=5))
    values.insert(M(), plane)
    factor = symmetry_factor(shape, PAIRS, M(), 1.0, on_plane=[7, 2])
    np.testing.assert_allclose(factor.unwhitenedError(values), 0, atol=1e-12)
    values.update(M(), plane.retract(np.array([0.1, 0, 0])))
    assert factor.error(values) > 1e-4


def test_the_papers_sign_is_that_of_a_plane_with_d_on_the_other_side():
    rng = np.random.default_rng(3)
    shape, values = bound_shape(rng)
    values.insert(M(), make_plane([0.1, -0.2, 1.0], 0.4))
    n, d = np.split(values.atOrientedPlane3(M()).planeCoefficients(), [3])
    X = shape.points(values)
    left, right = np.array(PAIRS).T
    printed = X[right] + 2 * ((-d) - X[right] @ n)[:, None] * n - X[left]
    np.testing.assert_allclose(symmetry_factor(shape, PAIRS, M(), 1.0).unwhitenedError(values), printed.ravel())


def test_recovers_the_medial_plane():
    rng = np.random.default_rng(4)
    truth = make_plane([0.02, -0.01, 1.0], 0.05)
    mean, basis = mirrored(rng, truth, PAIRS, [7])
    mean = mean + 1e-3 * rng.normal(size=mean.shape)
    shape = LinearShape(mean, basis, L(), O())
    values = gtsam.Values()
    values.insert(L(), np.zeros(5))
    values.insert(O(), np.zeros(42))
    values.insert(M(), make_plane([0, 0, 1], 0))
    graph = graph_of(
        symmetry_factor(shape, PAIRS, M(), 1e-4, on_plane=[7]),
        coefficients_prior(L(), 5),
        offsets_prior(O(), np.full(14, 0.01)),
    )
    result = optimize(graph, values)
    found = result.atOrientedPlane3(M())
    assert np.abs(found.localCoordinates(truth)).max() < 5e-3
    n, d = np.split(found.planeCoefficients(), [3])
    X = shape.points(result)
    for left, right in PAIRS:
        np.testing.assert_allclose(X[right] - 2 * (X[right] @ n + d) * n, X[left], atol=1e-5)


@pytest.mark.parametrize(
    ("pairs", "on_plane"),
    [([], []), ([(0, 0)], []), ([(0, 14)], []), ([(0, 1), (1, 2)], []), ([(0, 1)], [1]), ([0, 1], [])],
)
def test_bad_input(pairs, on_plane):
    shape, _ = bound_shape(np.random.default_rng(5))
    with pytest.raises(InvalidInputError):
        symmetry_factor(shape, pairs, M(), 1.0, on_plane=on_plane)
