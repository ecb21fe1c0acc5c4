"""What variables leave behind, and what several say of one: as GTSAM has it."""

import gtsam
import numpy as np
import pytest

from factors.keys import G
from factors.marginals import both, marginal, marginal_factor, normal_marginal


def vector(values):
    return np.array(values, dtype=float)


def said(rng, place, rows=3):
    """A marginal on G(0) of so many rows, about a place."""
    known = normal_marginal(G(0), vector(place), np.diag(rng.uniform(0.1, 1.0, 3)))
    return type(known)(known.keys, known.dims, known.values, known.matrix[:rows], rng.normal(size=rows))


@pytest.mark.parametrize("rows", [1, 3])
def test_both_are_as_gtsam_solves_them(rows):
    rng = np.random.default_rng(0)
    one, other = said(rng, [0.0, 0.0, 0.0]), said(rng, [0.2, -0.1, 0.3], rows)
    graph = gtsam.NonlinearFactorGraph()
    for some in (one, other):
        graph.add(marginal_factor(some))
    values = gtsam.Values(one.values)
    linear = graph.linearize(values)
    values = values.retract(linear.optimize())
    found = both(one, other)
    np.testing.assert_allclose(found.values.atVector(G(0)), values.atVector(G(0)), atol=1e-12)
    information, _ = graph.linearize(values).hessian()
    np.testing.assert_allclose(found.matrix.T @ found.matrix, information, atol=1e-12)
    np.testing.assert_allclose(found.matrix.T @ found.right, 0.0, atol=1e-12)


def test_what_a_mean_and_a_covariance_say():
    rng = np.random.default_rng(1)
    spread = rng.normal(size=(3, 3))
    known = normal_marginal(G(0), vector([1, 2, 3]), spread @ spread.T)
    assert known.values.atVector(G(0)).tolist() == [1.0, 2.0, 3.0]
    np.testing.assert_allclose(np.linalg.inv(known.matrix.T @ known.matrix), spread @ spread.T, rtol=1e-9)
    with pytest.raises(np.linalg.LinAlgError):
        normal_marginal(G(0), np.zeros(3), np.zeros((3, 3)))


def test_variables_that_leave_in_parts_leave_what_they_leave_as_a_whole():
    rng = np.random.default_rng(2)
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for key in range(6):
        values.insert(key, rng.normal(size=2))
        graph.add(gtsam.PriorFactorVector(key, rng.normal(size=2), gtsam.noiseModel.Isotropic.Sigma(2, 2.0)))
    noise = gtsam.noiseModel.Isotropic.Sigma(2, 0.5)
    for one, other in ((1, 3), (3, 5), (2, 4), (0, 1), (0, 4)):  # 1, 3 and 5, and 2 and 4, hang together; 0 stays
        graph.add(gtsam.BetweenFactorVector(one, other, rng.normal(size=2), noise))
    found = marginal(graph, values, [5, 1, 2, 3, 4])
    whole = gtsam.Marginals(graph, values).marginalInformation(0)
    np.testing.assert_allclose(found.matrix.T @ found.matrix, whole, rtol=1e-6)
    solved = graph.linearize(values).optimize().at(0)
    np.testing.assert_allclose(np.linalg.solve(found.matrix, found.right), solved, rtol=1e-6)
