"""The factor graph against the same energy written out independently, and solved by other solvers."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest

from factors import L, M, O, P, X
from factors.mixture import Form
from fgrecon.core.options import Options
from fgrecon.io.catalogue import load_prior
from fgrecon.solve.graph.graph import Graph, GraphObservation, State
from fgrecon.solve.graph.solver import minimise
from fgrecon.solve.graph.vehicle_part import _remembered as vehicle_part
from fgrecon.solve.proposals.problem import keypoint_covariances
from tests.solve.graph.energy import minimise_by_ceres, minimise_by_scipy
from tests.solve.graph.support import (
    energy_of,
    graph_at,
    problem_of,
    proposal,
    state_of,
    terms_of,
    unsymmetric,
    vector,
    weights_of,
)

NO_OFFSETS = np.zeros((14, 3))
PRIOR = load_prior("car14")
SCENES = {
    "symmetric": {},
    "covariances": {"seed": 2, "covariance": True},
    "neither ground nor size": {"seed": 2, "ground": False, "size": False},
    "cuboid": {"seed": 3, "box_model": "cuboid"},
    "no box": {"seed": 4, "box_model": "off"},
    "offsets": {"seed": 5, "free_offsets": True},
    "unsymmetric": {"seed": 6, "prior": unsymmetric(PRIOR)},
    "unsymmetric with offsets": {"seed": 7, "prior": unsymmetric(PRIOR), "free_offsets": True},
    "penalty": {"seed": 8, "plane_penalty": 0.5},
    "unsymmetric with penalty": {"seed": 9, "prior": unsymmetric(PRIOR), "plane_penalty": 1.0},
    "literal Laplacian": {"seed": 10, "literal_laplacian": True},
    "one vector": {"seed": 11, "basis_vectors": 1},
    "few terms": {"seed": 12, "disabled_terms": {"planarity", "laplacian", "dimensions", "box", "ground"}},
}


class Case:
    """Graph and independent energy of one problem at the best proposal."""

    def __init__(self, *, joint, **settings):
        self.problem, self.estimate = problem_of(**settings)
        self.state = proposal(self.problem, self.estimate)
        self.weights = self.state.weights[0]
        self.graph = graph_at(self.problem, self.state, pose_free=joint)
        self.terms = terms_of(self.graph, self.weights)
        self.values = self.graph.values(self.state)
        self.energy = energy_of(self.problem, self.weights, self.estimate.camera_T_object, joint=joint)

    def solve(self):
        built = self.graph.build([self.weights])
        return minimise(built, self.values, relative_tolerance=1e-15, max_iterations=100)

    def start(self):
        return self.energy.start(self.estimate.coefficients, NO_OFFSETS)


@pytest.fixture(scope="module", params=[False, True], ids=["shape", "joint"])
def joint(request):
    return request.param


@pytest.fixture(scope="module", params=SCENES.values(), ids=SCENES)
def case(request, joint):
    return Case(joint=joint, **request.param)


def test_each_term_is_the_independent_one(case):
    mine = {name: sum(factor.error(case.values) for factor in term) for name, term in case.terms.items()}
    assert mine.pop("cheirality") == 0.0
    x = vector(case.energy, case.graph, case.values)
    theirs = {name: 0.5 * np.sum(term**2) for name, term in case.energy.terms(x).items()}
    nothing = {"rectangularity"} if "rectangularity" not in mine else set()  # left out where it is zero for every shape
    assert all(theirs[name] < 1e-20 for name in nothing)
    assert set(mine) == {name for name, term in case.energy.terms(x).items() if len(term)} - nothing
    for name, value in mine.items():
        assert value == pytest.approx(theirs[name], rel=1e-9, abs=1e-12)


def test_the_compiled_linear_graph_and_error_are_those_of_what_is_built(case):
    """Whatever form it has, and wherever visibility was looked at."""
    graph, values = case.graph, case.values
    system = graph.system(values)
    point, ordering = system.point(values), gtsam.Ordering()
    for key in system.places:
        ordering.push_back(key)
    for hold in (False, True):
        weights = graph.reweigh_at(point, [case.weights], hold=hold)
        for form in (Form.NEWTON, Form.MAJORISED):
            step, energy = graph.step(point, weights, form)
            moved, information = system.moved(point, step), system.information(point).copy()
            energies = energy(), graph.error(moved)
            built = graph.build(weights, form)
            expected = built.error(system.values(point)), built.error(system.values(moved))
            assert energies == pytest.approx(expected, rel=1e-12)
            other = built.linearize(system.values(point)).hessian(ordering)[0]
            np.testing.assert_allclose(information, other, atol=1e-12 * np.abs(other).max())
        point = moved


def test_the_optimum_is_scipys(case):
    found = case.solve()
    oracle = minimise_by_scipy(case.energy, case.start())
    np.testing.assert_allclose(vector(case.energy, case.graph, found.values), oracle, atol=1e-6)
    assert found.error == pytest.approx(case.energy.cost(oracle), abs=1e-6)


@pytest.mark.parametrize("name", ["symmetric", "covariances", "unsymmetric", "penalty", "unsymmetric with offsets"])
def test_the_optimum_is_ceress(name, joint):
    pytest.importorskip("pyceres")
    case = Case(joint=joint, **SCENES[name])
    found = case.solve()
    oracle = minimise_by_ceres(case.energy, case.start())
    np.testing.assert_allclose(vector(case.energy, case.graph, found.values), oracle, atol=1e-6)
    assert found.error == pytest.approx(case.energy.cost(oracle), abs=1e-6)


def variables(case):
    return set(case.values.keys())


def test_a_symmetric_prior_needs_neither_symmetry_nor_mirrored_planes():
    """Both vanish for every lambda; the ground-parallel wheels stay, for their direction."""
    case = Case(joint=True, **SCENES["symmetric"])
    assert "symmetry" not in case.terms
    assert len(case.terms["planarity"]) == 2
    assert variables(case) == {X(), L(), P(0, 0)}
    for coefficients in np.random.default_rng(0).normal(size=(5, 5)):
        points = PRIOR.keypoints(coefficients)
        for face in PRIOR.category.faces:
            quad = points[list(face.keypoints)]
            assert np.linalg.svd(quad - quad.mean(axis=0), compute_uv=False)[2] < 1e-6
        np.testing.assert_allclose(points[PRIOR.category.mirror] * [1, 1, -1], points, atol=1e-6)


@pytest.mark.parametrize("name", ["offsets", "unsymmetric", "unsymmetric with offsets"])
def test_other_shapes_need_both(name):
    case = Case(joint=True, **SCENES[name])
    assert len(case.terms["symmetry"]) == 1
    assert len(case.terms["planarity"]) == len(PRIOR.category.faces) + 1
    offsets = {O()} if "offsets" in name else set()
    assert variables(case) == {X(), L(), M(), P(0, 0), P(0, 1), P(0, 2)} | offsets


def test_the_pose_is_a_constant_in_the_shape_stage():
    case = Case(joint=False, **SCENES["symmetric"])
    assert variables(case) == {L(), P(0, 0)}
    assert "ground" not in case.terms
    assert case.graph.observations[0].pose(case.values).equals(gtsam.Pose3(case.estimate.camera_T_object), 0.0)


@pytest.mark.parametrize(
    "term", sorted({*Options.TERMS} - {"direction", "points", "depth", "range", "mask"})
)  # one is no factor, the others not given
def test_each_term_can_be_left_out(term):
    whole = Case(joint=True, seed=5, free_offsets=True)
    part = Case(joint=True, seed=5, free_offsets=True, disabled_terms={term})
    assert set(whole.terms) - set(part.terms) == {term}
    built = part.graph.build([part.weights])
    used = {key for i in range(built.size()) for key in list(built.at(i).keys())}
    assert set(part.values.keys()) == used  # no variable is left without a factor


SOME = np.where(np.arange(14) == 4, 0.0, np.linspace(0.1, 1.0, 14))
"""Weights of which one is zero."""


@pytest.mark.parametrize("covariance", [False, True])
def test_every_keypoint_counts_by_its_weight(covariance):
    problem, estimate = problem_of(1, covariance=covariance)
    covariances = keypoint_covariances(problem.observation, problem.options.keypoints)
    for k in (0, 3, 11):
        state = proposal(problem, estimate, keypoints=np.where(np.arange(14) == k, 0.3, 0.0))
        graph = graph_at(problem, state)
        (factor,) = terms_of(graph, state.weights[0])["reprojection"]
        values = graph.values(state)
        away = graph.observations[0].projections(values)[k] - problem.observation.keypoints[k]
        assert factor.error(values) == pytest.approx(0.5 * 0.3 * away @ np.linalg.solve(covariances[k], away))


def test_without_any_weight_there_is_no_factor():
    problem, estimate = problem_of(1)
    state = proposal(problem, estimate, keypoints=np.zeros(14))
    assert "reprojection" not in terms_of(graph_at(problem, state), state.weights[0])


@pytest.mark.parametrize("covariance", [False, True])
@pytest.mark.parametrize("strategy", ["huber", "cauchy", "geman_mcclure", "tukey"])
def test_m_estimators_stand_in_the_graph(strategy, covariance):
    """Each keypoint's energy is its weight by confidence and visibility times the loss of its whitened residual."""
    problem, estimate = problem_of(1, strategy=strategy, covariance=covariance)
    state = proposal(problem, estimate, visibility=np.linspace(0.2, 1.0, 14))
    graph = graph_at(problem, state)
    values, chosen = graph.values(state), problem.options.strategy
    initial = chosen.mu0 * problem.energy.keypoints.evidence.right + (1 - chosen.mu0) * np.linspace(0.2, 1.0, 14)
    covariances = keypoint_covariances(problem.observation, problem.options.keypoints)
    (factor,) = terms_of(graph, state.weights[0])["reprojection"]
    away = graph.observations[0].projections(values) - problem.observation.keypoints
    distances = [np.sqrt(d @ np.linalg.solve(matrix, d)) for d, matrix in zip(away, covariances, strict=True)]
    assert factor.error(values) == pytest.approx(initial @ chosen.robust_loss.losses(distances))


def box_of(problem, estimate, **changes):
    """The box's residuals; None where it has no factor."""
    state = proposal(problem, estimate, **changes)
    graph = graph_at(problem, state)
    members = terms_of(graph, state.weights[0]).get("box")
    return None if members is None else members[0].unwhitenedError(graph.values(state))


def test_edges_of_no_weight_say_nothing():
    problem, estimate = problem_of(1)
    residual = box_of(problem, estimate, box=np.array([1.0, 0.0, 0.5, 1e-9]))
    assert (np.abs(residual) > 1e-3).tolist() == [True, False, True, False]
    assert box_of(problem, estimate, box=np.zeros(4)) is None


def test_edges_on_the_images_border_say_nothing():
    problem, estimate = problem_of(1)
    box, used = problem.energy.box, np.array([True, False, True, True])
    cut = replace(problem, energy=replace(problem.energy, box=replace(box, rows=replace(box.rows, used=used))))
    whole, part = (box_of(p, estimate, box=np.ones(4)) for p in (problem, cut))
    np.testing.assert_array_equal(part, np.where(used, whole, 0.0))


def test_values_are_read_back():
    problem, estimate = problem_of(5, free_offsets=True)
    pose, offsets = gtsam.Pose3(estimate.camera_T_object), np.random.default_rng(0).normal(size=(14, 3)) * 0.02
    state = state_of(pose, estimate.coefficients, weights_of(problem, estimate), offsets)
    state.shapes = {3: state.shapes[0]}
    graph = Graph([GraphObservation(problem, 3, 7)], state, pose_free=True)
    values = graph.values(state)
    back = graph.read(values, state.weights)
    assert back.poses[0].equals(pose, 0.0)
    np.testing.assert_array_equal(back.shapes[3][0], estimate.coefficients)
    np.testing.assert_array_equal(back.shapes[3][1], offsets)
    assert {X(3, 7), L(3), O(3), M(3)} <= set(values.keys())


def test_a_held_shape_is_a_constant():
    """Only the pose and the terms that are about it remain, and what is read is what was held."""
    problem, estimate = problem_of(5, free_offsets=True)
    offsets = np.random.default_rng(0).normal(size=(14, 3)) * 0.02
    state = state_of(estimate.camera_T_object, estimate.coefficients, weights_of(problem, estimate), offsets)
    held = Graph([GraphObservation(problem)], state, pose_free=True, hold_shape=True)
    whole = graph_at(problem, state)
    assert set(held.values(state).keys()) == {X()}
    assert set(terms_of(held, state.weights[0])) == {"reprojection", "cheirality", "box", "ground"}
    back = held.read(held.values(state), state.weights)
    np.testing.assert_array_equal(back.shapes[0][0], estimate.coefficients)
    np.testing.assert_array_equal(back.shapes[0][1], offsets)
    one, other = (graph.energies(graph.values(state), state.weights) for graph in (held, whole))
    assert one == pytest.approx({name: other[name] for name in one}, rel=1e-12)


def test_an_image_that_is_solved_alone_counts_as_in_its_graph():
    case = Case(joint=True, **SCENES["symmetric"])
    pose, shape = case.state.poses[0], case.state.shapes[0]
    seen = [GraphObservation(case.problem), GraphObservation(case.problem, image=1)]
    state = State([pose, pose], {0: shape}, [case.weights, case.weights])
    graph = Graph(seen, state, pose_free=True, earlier=3)
    alone, _ = graph.alone(1, graph.values(state), state.weights)
    assert alone.observations[0].share == graph.observations[1].share < 1.0


@pytest.mark.parametrize("free_offsets", [False, True])
def test_the_next_vehicles_system_is_as_if_it_were_the_first(free_offsets):
    """What a vehicle's system takes over from the last one of the same model changes nothing."""
    found = []
    for first in (None, 1):
        vehicle_part.cache_clear()
        for seed in (2,) if first is None else (first, 2):
            problem, estimate = problem_of(seed, free_offsets=free_offsets)
            state = proposal(problem, estimate)
            graph = graph_at(problem, state, pose_free=True)
            values = graph.values(state)
            system = graph.system(values)
            point = system.point(values)
            weights = graph.reweigh_at(point, state.weights)
            step, energy = graph.step(point, weights, Form.NEWTON)
            information = system.information(point)
        found.append([step, np.array([energy(), graph.error(point)]), information])
    for one, other in zip(*found, strict=True):
        np.testing.assert_array_equal(one, other)
