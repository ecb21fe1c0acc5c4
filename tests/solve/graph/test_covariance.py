"""Covariances against the inverse of a numeric Gauss-Newton matrix of the independent energy."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest

from factors.keys import L, S, X
from fgrecon.io.catalogue import load_prior
from fgrecon.solve.graph.covariance import (
    Spread,
    _covariance,
    marginals_of,
    projected_covariances,
    read_covariances,
)
from fgrecon.solve.graph.graph import Graph, GraphObservation, State
from fgrecon.solve.graph.observation_part import Weights
from fgrecon.solve.graph.vehicle_part import fleet_prior
from fgrecon.solve.pipeline import reconstruct
from tests.solve.graph.support import energy_of, graph_at, problem_of, solved, state_of, unsymmetric, vector

SCENES = {
    "symmetric": {},
    "covariances": {"covariance": True},
    "no ground": {"ground": False, "size": False, "box_model": "off"},
    "offsets": {"free_offsets": True},
    "unsymmetric": {"prior": unsymmetric(load_prior("car14"))},
    "penalty": {"plane_penalty": 0.7},
    "one vector": {"basis_vectors": 1},
    "no vector": {"basis_vectors": 0},
}


def at_result(seed=3, **settings):
    """A result, its graph, the values and the covariances there."""
    result = solved(seed, **settings)
    graph = result.graph()
    values = graph.values(result.optimum.state)
    return result, graph, values, covariances(graph, values, result.weights)


def covariances(graph, values, weights):
    marginals = marginals_of(graph, values, [weights], as_assumed=True)
    return read_covariances(graph.observations[0], weights, values, marginals)


@pytest.mark.parametrize("settings", SCENES.values(), ids=SCENES)
def test_the_inverse_of_the_gauss_newton_matrix(settings):
    result, graph, values, found = at_result(**settings)
    problem = result.problem
    energy = energy_of(problem, result.weights, result.pose.matrix(), joint=True)
    jacobian = energy.jacobian(vector(energy, graph, values))
    whole = np.linalg.inv(jacobian.T @ jacobian)
    count = problem.model.prior.dimension

    def same(actual, expected):
        np.testing.assert_allclose(actual, expected, rtol=0, atol=1e-5 * max(np.abs(expected).max(initial=0.0), 1e-9))

    same(found.pose, whole[:6, :6])
    same(found.coefficients, whole[6 : 6 + count, 6 : 6 + count])
    variables = whole[6:, 6:]
    for k in range(14):
        derivative = np.zeros((3, len(variables)))
        derivative[:, :count] = problem.model.prior.basis[:, k].T
        if problem.options.shape.free_offsets:
            derivative[:, count + 3 * k : count + 3 * k + 3] = np.eye(3)
        same(found.keypoints[k], derivative @ variables @ derivative.T)


def test_more_evidence_is_less_uncertainty():
    result, graph, values, sure = at_result()
    less = replace(result.weights, keypoints=0.25 * result.weights.keypoints, box=0.25 * result.weights.box)
    weaker = covariances(graph, values, less)
    assert (np.linalg.eigvalsh(weaker.pose - sure.pose) > -1e-12).all()
    assert (np.linalg.eigvalsh(weaker.coefficients - sure.coefficients) > -1e-12).all()
    assert np.linalg.eigvalsh(sure.coefficients).max() <= 1.0 + 1e-9  # never beyond the prior


def test_the_pose_of_no_keypoint_is_undetermined():
    result, graph, values, found = at_result(ground=False, size=False, box_model="off")
    assert found is not None
    assert covariances(graph, values, replace(result.weights, keypoints=np.zeros(14), box=np.zeros(4))) is None


def test_the_frame_is_the_objects_own():
    """Far away the position is least sure along the viewing ray: the object-frame covariance, turned, says so."""
    result, _, _, found = at_result(ground=False, size=False, box_model="off", yaw=1.1)
    R = result.pose.rotation().matrix()
    worst = np.linalg.eigh(R @ found.pose[3:, 3:] @ R.T)[1][:, -1]
    ray = result.pose.translation() / np.linalg.norm(result.pose.translation())
    assert abs(worst @ ray) > 0.98


@pytest.mark.parametrize("strategy", ["mixture", "cauchy", "tukey"])
def test_what_is_reported_is_that_of_the_weighted_keypoints(strategy, monkeypatch):
    """End to end, also where the graph holds an m-estimator: each keypoint counts by its final weight, and once.

    What the solve takes sizes for is not how they spread: the error of its minimum has both. What the chance of a van
    adds is left out (`tests.solve.test_either_class`).
    """
    monkeypatch.setattr("fgrecon.solve.pipeline.with_either_class", lambda result, *_: result)
    problem, _ = problem_of(4, strategy=strategy, box_model="off")
    result = reconstruct(
        problem.observation, problem.camera, ground=problem.ground, size_prior="kitti", options=problem.options
    )
    weights = Weights(result.diagnostics.weights, result.diagnostics.visibility, np.ones(4), result.location[2])
    state = state_of(result.camera_T_object, result.shape.coefficients, weights, result.shape.offsets)
    graph = graph_at(problem, state)
    energy = energy_of(problem, weights, result.camera_T_object, joint=True)
    jacobian = energy.jacobian(vector(energy, graph, graph.values(state)))
    information, vehicle = jacobian.T @ jacobian, graph.vehicles[0]
    model, shape = vehicle.model, vehicle.shape
    sizes = np.tensordot(model.prior.category.dimension_operator, shape.derivative, axes=2)
    taken = np.eye(5) + sizes[:, :5].T @ np.diag(model.size.assumed_sigma**-2.0) @ sizes[:, :5]
    one_class = model.spread_of(model.size.own_spread if strategy == "mixture" else model.size.spread)
    noise = information.copy()
    noise[6:11, 6:11] += taken @ one_class @ taken - taken
    whole = np.linalg.inv(information) @ noise @ np.linalg.inv(information)
    np.testing.assert_allclose(
        result.uncertainty.pose_covariance, whole[:6, :6], atol=0.02 * np.abs(whole[:6, :6]).max()
    )
    np.testing.assert_allclose(result.uncertainty.coefficients_covariance, whole[6:11, 6:11], atol=0.02)


def test_sizes_that_spread_more_than_a_solve_takes_them_for_move_it_more():
    """Minima of a quadratic form, sampled: its prior on lambda is tighter than that from which lambda is drawn."""
    rng = np.random.default_rng(5)
    half, root, taken_root = rng.normal(size=(12, 6)), rng.normal(size=(3, 3)), rng.normal(size=(3, 3))
    drawn, taken = root @ root.T + np.eye(3), taken_root @ taken_root.T + 2.0 * np.eye(3)
    said = half.T @ half
    whole = said.copy()
    whole[3:, 3:] += taken
    inverse, places = np.linalg.inv(whole), {X(): np.arange(3), L(): np.arange(3, 6)}

    def solved(keys):
        at = np.concatenate([places[key] for key in keys])
        return inverse[np.ix_(at, at)]

    found = Spread(solved, {0: (L(), taken @ drawn @ taken - taken)}).joint([X(), L()])
    noise, shapes = rng.normal(size=(200_000, 12)) @ half, np.zeros((200_000, 6))
    shapes[:, 3:] = rng.multivariate_normal(np.zeros(3), drawn, len(shapes), method="cholesky")
    pulled = shapes.copy()
    pulled[:, 3:] = shapes[:, 3:] @ taken
    errors = (noise - pulled) @ inverse
    np.testing.assert_allclose(found, errors.T @ errors / len(errors), atol=0.02 * np.abs(found).max())
    np.testing.assert_array_equal(Spread(solved).joint([X()]), inverse[:3, :3])


def test_vehicles_of_an_assumed_fleet_are_unsure_together():
    """Two vehicles with nothing but their fleet in common, against what each image says and the joint prior of both."""
    cars = [solved(seed, ground=False, size=False, box_model="off") for seed in (3, 4)]
    ends, weights = [car.optimum.state for car in cars], [car.weights for car in cars]
    others = gtsam.Values()
    others.insert(S(), np.zeros(3))
    state = State([end.poses[0] for end in ends], {i: end.shapes[0] for i, end in enumerate(ends)}, weights, others)
    seen, model = [GraphObservation(car.problem, vehicle=i) for i, car in enumerate(cars)], cars[0].problem.model
    graph = Graph(seen, state, pose_free=True, extra=[fleet_prior(model)])
    joint = marginals_of(graph, graph.values(state), weights).joint([L(0), L(1)])

    count = model.prior.dimension
    alike = model.by_size @ model.fleet_spread @ model.by_size.T
    prior = np.kron(np.ones((2, 2)), alike) + np.eye(2 * count)
    said = np.zeros((2 * count, 2 * count))
    for number, car in enumerate(cars):
        own = slice(number * count, (number + 1) * count)
        one = car.graph()
        alone = marginals_of(one, one.values(car.optimum.state), [car.weights])
        covariance = alone.joint([L(0)])
        said[own, own] = np.linalg.inv(covariance) - np.linalg.inv(alike + np.eye(count))
    expected = np.linalg.inv(np.linalg.inv(prior) + said)
    np.testing.assert_allclose(joint, expected, atol=1e-5 * np.abs(expected).max())
    assert model.dimension_basis[0] @ joint[:count, count:] @ model.dimension_basis[0] > 0.0


@pytest.mark.parametrize("settings", [{"free_offsets": True}, {"free_offsets": True, "ground": False, "size": False}])
def test_covariances_of_projections_are_those_of_samples(settings):
    """Pose and shape drawn together from what the graph leaves open."""
    result, graph, values, _ = at_result(**settings)
    marginals = gtsam.Marginals(graph.build([result.weights]), values)
    part = graph.observations[0]
    found = projected_covariances(part, values, Spread.by_gtsam(marginals))
    keys = list(part.keys)
    joint = marginals.jointMarginalCovariance(gtsam.KeyVector(keys))
    whole = np.block([[joint.at(a, b) for b in keys] for a in keys])
    rng, scale = np.random.default_rng(0), 0.1  # small enough for a linear projection
    drawn = []
    for step in scale * rng.multivariate_normal(np.zeros(len(whole)), whole, 4000, method="cholesky"):
        moved = gtsam.Values(values)
        moved.update(keys[0], values.atPose3(keys[0]).retract(step[:6]))
        at = 6
        for key in keys[1:]:
            before = values.atVector(key)
            moved.update(key, before + step[at : at + len(before)])
            at += len(before)
        drawn.append(part.projections(moved))
    off = (np.array(drawn) - part.projections(values)) / scale
    sampled = np.einsum("ski,skj->kij", off, off) / len(off)
    np.testing.assert_allclose(found, sampled, rtol=0.0, atol=0.1 * np.abs(found).max(axis=(1, 2)).max())
    for one, other in zip(found, sampled, strict=True):
        np.testing.assert_allclose(one, other, rtol=0.0, atol=0.12 * np.trace(one))


def test_one_factorisation_gives_what_gtsam_gives():
    """Of all variables, and of some of them, in the order that is asked for."""
    result, graph, values, _ = at_result()
    marginals, keys = gtsam.Marginals(graph.build([result.weights]), values), list(values.keys())
    assert len(keys) > 1
    for wanted in (None, {keys[0]}):
        spread = marginals_of(graph, values, [result.weights], wanted, as_assumed=True)
        for key in keys if wanted is None else wanted:
            expected = marginals.marginalCovariance(key)
            np.testing.assert_allclose(spread.joint([key]), expected, rtol=1e-6, atol=1e-9 * np.abs(expected).max())
    own = [X(), L()]
    turned, count = marginals_of(graph, values, [result.weights], as_assumed=True).joint(own[::-1]), 5
    np.testing.assert_allclose(turned[:count, :count], marginals.marginalCovariance(L()), rtol=1e-6, atol=1e-9)


def test_without_kernels_an_information_is_inverted_or_found_open():
    rng = np.random.default_rng(0)
    half = rng.normal(size=(19, 7)) * np.logspace(0.0, 3.0, 7)
    expected = np.linalg.inv(half.T @ half)
    found = _covariance(half.T @ half, 1e-12)(np.array([4, 1]))
    np.testing.assert_allclose(found, expected[[4, 1]][:, [4, 1]], rtol=1e-8)
    assert _covariance(half.T @ half, 1.1) is None
    assert _covariance(np.kron([[1.0, -1.0], [-1.0, 1.0]], np.eye(2)), 1e-12) is None  # a difference alone is known
    assert _covariance(np.diag([1.0, 0.0]), 1e-12) is None
