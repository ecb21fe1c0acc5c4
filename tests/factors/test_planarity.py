"""Planarity and ground-parallel factors, with unit normals and with the penalty."""

import gtsam
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from factors.errors import InvalidInputError
from factors.keys import L, O, P
from factors.planarity import ground_parallel_factor, planarity_factor
from factors.planes import fit_plane
from factors.shape_prior import coefficients_prior, offsets_prior
from tests.factors.support import assert_jacobian, bound_shape, graph_of, optimize, quad_at, random_plane

FACE = [2, 0, 5, 7]


@settings(deadline=None, derandomize=True, max_examples=8)
@given(st.integers(0, 2**32 - 1), st.booleans())
def test_jacobians(seed, with_offsets):
    rng = np.random.default_rng(seed)
    shape, values = bound_shape(rng, with_offsets=with_offsets)
    values.insert(P(), random_plane(rng))
    values.insert(P(0, 1), rng.normal(size=4))
    assert_jacobian(planarity_factor(shape, FACE, P(), 1.0), values)
    assert_jacobian(planarity_factor(shape, FACE, P(0, 1), 1.0, mu=2.5), values)
    assert_jacobian(ground_parallel_factor(P(), 1.0), values)
    assert_jacobian(ground_parallel_factor(P(), 1.0, rng.normal(size=3)), values)
    assert_jacobian(ground_parallel_factor(P(0, 1), 1.0, free=True), values)


def test_residual_is_the_distance():
    shape, values = bound_shape(np.random.default_rng(0))
    values.insert(P(), gtsam.OrientedPlane3(np.array([0.0, -1.0, 0.0, 0.3])))
    residual = planarity_factor(shape, FACE, P(), 1.0).unwhitenedError(values)
    np.testing.assert_allclose(residual, 0.3 - shape.points(values)[FACE, 1])


@pytest.mark.parametrize("angle", [0.0, 0.1, np.pi])
def test_ground_parallel_is_the_sine_and_knows_no_sign(angle):
    values = gtsam.Values()
    normal = [np.sin(angle), np.cos(angle), 0.0]
    values.insert(P(), gtsam.OrientedPlane3(np.array([*normal, 1.0])))
    values.insert(P(0, 1), np.array([*normal, 1.0]))
    for factor in (ground_parallel_factor(P(), 1.0), ground_parallel_factor(P(0, 1), 1.0, free=True)):
        assert np.linalg.norm(factor.unwhitenedError(values)) == pytest.approx(abs(np.sin(angle)), abs=1e-12)


def warped():
    corners = np.array([[1, 0, 1], [1, 0.2, -1], [-1, 0, -1], [-1, 0.2, 1]], dtype=float)
    shape, values = quad_at(corners)
    priors = [coefficients_prior(L(), 3, 1e-3), offsets_prior(O(), np.full(6, 0.5))]
    return shape, values, priors


def test_flattens_a_warped_face_with_either_form():
    shape, values, priors = warped()
    quad = [0, 1, 2, 3]
    start = fit_plane(shape.mean[:4])
    values.insert(P(), start)
    values.insert(P(0, 1), start.planeCoefficients())
    unit = optimize(graph_of(planarity_factor(shape, quad, P(), 1e-4), *priors), values)
    penalty = optimize(graph_of(planarity_factor(shape, quad, P(0, 1), 1e-4, mu=1.0), *priors), values)
    plane = unit.atOrientedPlane3(P()).planeCoefficients()
    np.testing.assert_allclose(shape.points(unit)[:4] @ plane[:3] + plane[3], 0, atol=1e-6)
    free = penalty.atVector(P(0, 1))
    assert np.linalg.norm(free[:3]) == pytest.approx(1, abs=1e-4)
    np.testing.assert_allclose(shape.points(penalty), shape.points(unit), atol=1e-4)
    np.testing.assert_allclose(shape.points(unit)[:4, 1], 0.1, atol=1e-4)


def test_ground_parallel_levels_the_face():
    corners = np.array([[1, 0.1, 1], [1, 0.1, -1], [-1, -0.1, -1], [-1, -0.1, 1]])
    shape, values = quad_at(corners)
    values.insert(P(), fit_plane(corners))
    graph = graph_of(
        planarity_factor(shape, range(4), P(), 1e-4),
        ground_parallel_factor(P(), 1e-4),
        coefficients_prior(L(), 3, 1e-3),
        offsets_prior(O(), np.full(6, 0.5)),
    )
    result = optimize(graph, values)
    np.testing.assert_allclose(shape.points(result)[:4, 1], 0, atol=1e-4)


@pytest.mark.parametrize(
    "call",
    [
        lambda s: planarity_factor(s, [0, 1], P(), 1.0),
        lambda s: planarity_factor(s, [0, 1, 14], P(), 1.0),
        lambda s: planarity_factor(s, [0, 1, 1], P(), 1.0),
        lambda s: planarity_factor(s, [0, 1, 2], P(), 1.0, mu=0.0),
        lambda s: ground_parallel_factor(P(), 1.0, up=np.zeros(3)),
    ],
)
def test_bad_input(call):
    shape, _ = bound_shape(np.random.default_rng(1))
    with pytest.raises(InvalidInputError):
        call(shape)
