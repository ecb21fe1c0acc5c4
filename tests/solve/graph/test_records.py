"""The structure of the graph as it is drawn: every factor once, with the variables that it really has."""

import numpy as np
import pytest

from factors import key_name
from fgrecon.solve.graph.records import graph_factors
from tests.solve.graph.support import graph_at, problem_of, proposal, terms_of


def described(seed=0, **settings):
    problem, start = problem_of(seed, **settings)
    weights = np.where(np.arange(len(start.weights)) == 2, 0.0, 1.0)
    state = proposal(problem, start, keypoints=weights, visibility=weights, box=np.ones(4))
    graph = graph_at(problem, state)
    return problem, terms_of(graph, state.weights[0]), graph_factors(graph, state.weights)


@pytest.mark.parametrize("settings", [{}, {"free_offsets": True}])
def test_every_factor_is_there_with_its_variables(settings):
    _, terms, found = described(**settings)
    for name, members in terms.items():
        records = [factor for factor in found if factor.term == name]
        if name != "reprojection":
            expected = [tuple(map(key_name, factor.keys())) for factor in members]
            assert [factor.variables for factor in records] == expected
    assert {factor.term for factor in found} == set(terms)


def test_keypoints_without_measurement_or_weight_have_none():
    problem, _, found = described()
    names = problem.model.prior.category.keypoints
    labels = [factor.label for factor in found if factor.term == "reprojection"]
    expected = [name for i, name in enumerate(names) if problem.observation.measured[i] and i != 2]
    assert labels == expected
    assert {factor.variables for factor in found if factor.term == "reprojection"} == {("X(v=0,t=0)", "L(v=0)")}


def test_labels_tell_factors_of_one_term_apart():
    *_, found = described(free_offsets=True)
    keys = [(factor.term, factor.label) for factor in found if factor.term != "rectangularity"]
    assert len(set(keys)) == len(keys)
    assert ("planarity", "wheels level") in keys
