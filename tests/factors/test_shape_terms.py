"""Symmetry, rectangularity and dimensions in one compiled factor: the factors themselves are the oracle."""

import gtsam
import numpy as np
import pytest

from factors import L, M, dimensions_factor, rectangularity_factor, symmetry_factor
from factors.native import native
from factors.shape_terms import ShapeTerms
from tests.factors.support import assert_jacobian, bound_shape, context_of, graph_of, random_plane

KERNEL = native("factors._shape")
pytestmark = pytest.mark.skipif(KERNEL is None, reason="no compiled kernel")
PAIRS, MIDDLE, QUADS = [(0, 1), (2, 3), (4, 5)], [6, 7], [(0, 1, 3, 2), (8, 9, 10, 11)]


def case(seed, *, offsets, symmetric=True, rectangles=True, sized=True):
    """The stack, the separate factors, and a state."""
    rng = np.random.default_rng(seed)
    shape, values = bound_shape(rng, with_offsets=offsets)
    operator, size, sigma = rng.normal(size=(3, 14, 3)), rng.normal(size=3), rng.uniform(0.1, 0.4, 3)
    names, alone = set(), []
    about = context_of(shape, PAIRS, MIDDLE, QUADS, operator=operator, size=(size, sigma))
    if symmetric:
        values.insert(M(), random_plane(rng))
        names.add("symmetry")
        alone.append(symmetry_factor(shape, PAIRS, M(), 0.02, on_plane=MIDDLE))
    if rectangles:
        names.add("rectangularity")
        alone += [rectangularity_factor(shape, quad, 0.05) for quad in QUADS]
    if sized:
        names.add("dimensions")
        alone.append(dimensions_factor(shape, operator, size, sigma))
    return ShapeTerms(KERNEL, about, names), alone, values


@pytest.mark.parametrize("offsets", [False, True])
@pytest.mark.parametrize("without", [None, "symmetric", "rectangles", "sized"])
def test_the_stack_is_its_factors(offsets, without):
    for seed in range(4):
        terms, alone, values = case(seed, offsets=offsets, **({} if without is None else {without: False}))
        together, apart = graph_of(terms.factor()), graph_of(*alone)
        assert together.error(values) == pytest.approx(apart.error(values), rel=1e-12)
        ordering = gtsam.Ordering()
        for key in values.keys():  # noqa: SIM118  # a key vector
            ordering.push_back(key)
        mine, theirs = (graph.linearize(values).augmentedHessian(ordering) for graph in (together, apart))
        np.testing.assert_allclose(mine, theirs, atol=1e-11 * np.abs(theirs).max())
        assert_jacobian(terms.factor(), values, step=1e-4)


def test_energies_are_reported_term_by_term():
    terms, alone, values = case(0, offsets=True)
    errors = [factor.error(values) for factor in alone]
    expected = {"symmetry": errors[0], "rectangularity": errors[1] + errors[2], "dimensions": errors[3]}
    assert dict(terms.energies(values)) == pytest.approx(expected, rel=1e-12)


def test_a_diagonal_of_no_length_has_no_direction():
    rng = np.random.default_rng(0)
    shape, values = bound_shape(rng)
    shape.mean[8] = shape.mean[10]
    shape.basis[:, 8] = shape.basis[:, 10]
    residual, jacobian = ShapeTerms(KERNEL, context_of(shape, quads=QUADS), {"rectangularity"})(
        values, want_jacobian=True
    )
    assert np.isfinite(residual).all()
    assert np.isfinite(jacobian).all()


def test_an_index_out_of_range_is_refused_at_the_border():
    shape, _ = bound_shape(np.random.default_rng(0))
    with pytest.raises(ValueError, match="do not belong together"):
        ShapeTerms(KERNEL, context_of(shape, pairs=[(0, 14)]), {"symmetry"})
    assert L() in shape.keys
