"""The weights that a result holds are those of its own residuals, and no others."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest

from factors import reprojection_factor
from factors.keypoint_rows import SMALLEST_WEIGHT
from factors.mixture import Form
from fgrecon.core.observation import Observation
from fgrecon.solve.graph.graph import GraphObservation
from fgrecon.solve.graph.graph_settings import SETTINGS
from fgrecon.solve.graph.solver import minimise
from fgrecon.solve.proposals.pose_search import search_pose
from fgrecon.solve.proposals.problem import Problem, keypoint_covariances
from fgrecon.solve.proposals.terms import Hypotheses
from fgrecon.solve.result import results
from tests.solve.graph.support import graph_at, problem_of, solve, state_of, terms_of, weights_at

SETTLED = SETTINGS.reweighting.settled_weight_change


@pytest.mark.parametrize(("seed", "strategy"), [(2, "mixture"), (2, "tukey"), (4, "cauchy"), (4, "tukey")])
def test_the_weights_belong_to_the_result(seed, strategy):
    """They have settled: made anew from the result they are the same, which those of the pose search are not."""
    problem, start = problem_of(seed, strategy=strategy)
    result = solve(problem, start)
    assert result.failure is None
    again, box_weights, visibility = weights_at(problem, result.pose.matrix(), result.coefficients)
    assert np.abs(result.weights.keypoints - start.weights).max() > 20 * SETTLED
    np.testing.assert_allclose(result.weights.keypoints, again, atol=3 * SETTLED)
    np.testing.assert_allclose(result.weights.box, box_weights, atol=SETTLED)
    np.testing.assert_allclose(result.weights.visibility, visibility, atol=SETTLED)


@pytest.mark.parametrize("covariance", [False, True])
@pytest.mark.parametrize("strategy", ["mixture", "gnc", "paper"])
def test_the_result_tells_the_noise_of_its_graph(strategy, covariance):
    """Its sigmas are those of the rows' whiteners with their weights; with covariances by the determinants."""
    problem, start = problem_of(2, strategy=strategy, covariance=covariance)
    found = solve(problem, start)
    (result,) = results([GraphObservation(problem)], [start], found.adjusted, {})
    part = found.graph().observations[0]
    part.tell(found.weights, Form.WEIGHTED)
    used = problem.observation.measured & (result.diagnostics.weights >= SMALLEST_WEIGHT)
    assert used.any()
    blocks = []
    for (a, b, c), weight in zip(part.rows.keypoints.whitener[used], part.rows.right[used], strict=True):
        root = np.array([[a, 0.0], [b, c]])
        blocks.append(np.linalg.inv(weight * root.T @ root))
    np.testing.assert_allclose(np.linalg.det(blocks) ** 0.25, result.diagnostics.sigmas[used], rtol=1e-9)
    assert bool(np.abs([block[0, 1] for block in blocks]).max() > 0.1) is covariance


@pytest.mark.parametrize("covariance", [False, True])
@pytest.mark.parametrize("strategy", ["huber", "cauchy", "geman_mcclure", "tukey"])
def test_gtsams_m_estimators_end_where_reweighting_by_hand_ends(strategy, covariance):
    """An m-estimator inside the factor, or the factor with w = w0 rho'(d) / d made anew until still."""
    problem, start = problem_of(1, strategy=strategy, covariance=covariance, box_model="off")
    result = solve(problem, start)
    chosen, held = problem.options.strategy, result.weights
    initial = chosen.mu0 * problem.energy.keypoints.evidence.right + (1.0 - chosen.mu0) * held.visibility
    # From beside the result: some of these losses have other minima, too.
    beside = result.pose.retract(np.array([0.01, -0.02, 0.01, 0.03, 0.02, -0.1]))
    state = state_of(beside, result.coefficients + 0.1, held)
    graph = graph_at(problem, state)
    part, values, pixels = graph.observations[0], graph.values(state), problem.observation.keypoints
    covariances = keypoint_covariances(problem.observation, problem.options.keypoints)
    others = [term for name, term in terms_of(graph, state.weights[0]).items() if name != "reprojection"]
    for _ in range(400):
        away = part.projections(values) - pixels
        distance = np.sqrt(np.einsum("ki,kij,kj->k", away, np.linalg.inv(covariances), away))
        weights = initial * chosen.robust_loss.weights(distance[:, None])[:, 0]
        built = gtsam.NonlinearFactorGraph()
        for factor in (factor for term in others for factor in term):
            built.add(factor)
        built.add(reprojection_factor(part.kernel, pixels, weights, covariances))
        before, values = values, minimise(built, values, relative_tolerance=1e-15).values
        if np.abs(before.localCoordinates(values).vector()).max() < 1e-10:
            break
    np.testing.assert_allclose(part.pose(values).matrix(), result.pose.matrix(), atol=1e-6)
    np.testing.assert_allclose(graph.vehicles[0].read(values)[0], result.coefficients, atol=1e-6)
    np.testing.assert_allclose(weights, held.keypoints, atol=1e-6)


@pytest.mark.parametrize("strategy", ["mixture", "huber"])
def test_the_energies_are_those_of_the_pose_search(strategy):
    """Terms that both stages have are reported alike; only the ground's has an uncertainty of its own."""
    problem, start = problem_of(1, strategy=strategy)
    result = solve(problem, start)
    pose = result.pose.matrix()[None]
    held = replace(problem.energy, visibility=lambda poses: np.tile(result.weights.visibility, (len(poses), 1)))
    search = held.energies(Hypotheses(pose[:, :3, :3], pose[:, :3, 3], result.coefficients[None]))
    shared = set(search) - {"ground"}
    assert shared == {"reprojection", "box", "dimensions", "coefficients"}
    for name in shared:
        assert result.energies[name] == pytest.approx(search[name][0], rel=1e-9)
    assert set(result.energies) == set(search) | {"cheirality", "planarity", "laplacian"}


@pytest.mark.parametrize("edge", range(4))
def test_a_wrong_edge_of_the_box_loses_its_weight(edge):
    """An edge that is far off counts for nothing, and the car stays where the right edges and the keypoints have it."""
    problem, start = problem_of(3)
    seen = problem.observation
    box = seen.box.copy()
    box[edge] += (-0.3 if edge < 2 else 0.3) * seen.extent
    spoilt = Problem.of(
        Observation(seen.keypoints, seen.confidence, box),
        problem.camera,
        problem.model,
        problem.ground,
        problem.options,
    )
    right, wrong = solve(problem, start), solve(spoilt, search_pose(spoilt))
    others = np.arange(4) != edge
    assert wrong.weights.box[edge] < 0.01
    assert wrong.weights.box[others].min() > 0.5
    assert right.weights.box.min() > 0.5
    assert np.linalg.norm(wrong.pose.translation() - right.pose.translation()) < 0.03 * right.pose.z()
