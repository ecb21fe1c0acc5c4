"""From proposals to the minimum: where it ends, what it reports, and how it fails."""

from dataclasses import replace

import numpy as np
import pytest

from fgrecon.core.robust import StrategyName
from fgrecon.io.catalogue import load_prior
from fgrecon.solve.graph.graph_settings import SETTINGS
from fgrecon.solve.graph.solver import minimise
from tests.cars import rotation_angle, yaw_pose
from tests.solve.graph.energy import minimise_by_scipy
from tests.solve.graph.support import (
    energy_of,
    graph_at,
    problem_of,
    proposal,
    solve,
    solved,
    state_of,
    terms_of,
    weights_at,
)


@pytest.mark.parametrize(
    "settings",
    [
        {},
        {"joint": False},
        {"free_offsets": True},
        {"covariance": True},
        {"strategy": "huber"},
        {"strategy": "tukey"},
        {"strategy": "gnc"},
    ],
    ids=str,
)
@pytest.mark.parametrize("seed", [0, 1])
def test_the_result_is_the_minimum_for_its_weights(seed, settings):
    """Another solver, from the best proposal and with the final weights, ends at the same pose and lambda."""
    result = solved(seed, **settings)
    problem, start = result.problem, result.start
    assert result.failure is None
    assert result.optimum.unfinished is None
    energy = energy_of(problem, result.weights, start.camera_T_object, joint=problem.options.shape.joint)
    x = minimise_by_scipy(energy, energy.start(start.coefficients, np.zeros((14, 3))))
    near = 5.0 * SETTINGS.newton.steady  # the last step is below `steady`; visibility comes to rest by a part a step
    np.testing.assert_allclose(result.pose.matrix(), energy.pose_at(x), atol=near)
    np.testing.assert_allclose(result.coefficients, energy.split(x)[1], atol=near)
    points = problem.model.prior.keypoints(result.coefficients, result.offsets)
    np.testing.assert_allclose(points, energy.points_at(x), atol=near)
    assert np.abs(result.coefficients - start.coefficients).max() > 2e-3  # which are not the start


@pytest.mark.parametrize(
    ("settings", "stages"),
    [({}, ("joint",)), ({"joint": False}, ("shape",)), ({"strategy": "paper"}, ("shape", "joint"))],
    ids=str,
)
def test_stages(settings, stages):
    """Pose and shape move together from the proposals on; the paper's strategies solve at the fixed pose first."""
    result = solved(1, **settings)
    names = [iteration.stage for iteration in result.history]
    assert set(names) == set(stages)
    assert names == sorted(names, key=["shape", "joint"].index)
    fixed = [iteration for iteration in result.history if iteration.stage == "shape"]
    for iteration in fixed:
        np.testing.assert_allclose(iteration.camera_T_object, result.start.camera_T_object, atol=1e-15)
    last = result.history[-1]
    np.testing.assert_allclose(last.camera_T_object, result.pose.matrix(), atol=1e-6)
    np.testing.assert_allclose(last.coefficients, result.coefficients, atol=1e-6)
    np.testing.assert_allclose(last.weights, result.weights.keypoints, atol=1e-6)
    assert last.energies == pytest.approx(result.energies, abs=1e-6)


@pytest.mark.parametrize(("seed", "strategy"), [(2, "cauchy"), (4, "huber"), (5, "paper"), (6, "gnc")])
def test_every_update_starts_where_the_last_one_ended_and_goes_down(seed, strategy):
    """With visibility made anew each update's weights are those at the end of the last one, its steps a solve's."""
    # Without planarity pose and lambda are all there is: the state is what the history holds.
    problem, start = problem_of(seed, strategy=strategy, disabled_terms={"planarity"})
    result = solve(problem, replace(start, alternatives=()))
    by_update, seen = {}, []
    for number, stage in enumerate(result.adjusted.stages):
        for step in stage.steps:
            by_update.setdefault((number, step.update), []).append(step)
    pose, coefficients, weights = start.camera_T_object, start.coefficients, start.weights
    for (number, update), steps in by_update.items():
        stage = result.adjusted.stages[number]
        (reported,) = steps[0].weights
        if any(reported.visibility is known for known in seen):
            break  # visibility is held from here on
        seen.append(reported.visibility)
        assert [step.step for step in steps] == list(range(len(steps)))
        progress = min(update / (problem.options.strategy.updates - 1), 1.0)
        weights, edges, visibility = weights_at(problem, pose, coefficients, previous=weights, progress=progress)
        np.testing.assert_allclose(reported.keypoints, weights, atol=1e-12)
        np.testing.assert_allclose(reported.box, edges, atol=1e-9)
        np.testing.assert_allclose(reported.visibility, visibility, atol=1e-12)
        assert reported.depth == pytest.approx(pose[2, 3], abs=1e-12)
        state = state_of(pose, coefficients, reported)
        graph = graph_at(problem, state, pose_free=stage.name == "joint")
        values, built = graph.values(state), graph.build([reported])
        path = minimise(
            built, values, relative_tolerance=SETTINGS.reweighting.early_relative_decrease, record=True
        ).path
        for mine, step in zip(path, steps, strict=False):  # the last update goes on for longer
            one, other = graph.read(mine, [reported]), stage.graph.read(step.values, [reported])
            np.testing.assert_allclose(one.poses[0].matrix(), other.poses[0].matrix(), atol=1e-8)
            np.testing.assert_allclose(one.shapes[0][0], other.shapes[0][0], atol=1e-8)
        assert len(steps) >= len(path) > 0
        errors = [built.error(values), *(stage.graph.build([reported]).error(step.values) for step in steps)]
        assert errors == sorted(errors, reverse=True)
        end = stage.graph.read(steps[-1].values, [reported])
        pose, coefficients = end.poses[0].matrix(), end.shapes[0][0]
    assert len(seen) >= 3


def test_the_shape_comes_closer_to_the_truth_than_the_mean():
    """Keypoints of random cars in the object frame: by 15 % in the median, without the pull towards the mean's form."""
    before, after = [], []
    for seed in range(12):
        rng = np.random.default_rng(seed)  # as `problem_of` draws them
        rng.uniform(size=3)
        truth = load_prior("car14").keypoints(rng.normal(size=5))
        settings = {"size": False, "sigma_relative": 0.01, "disabled_terms": {"laplacian"}}
        result = solved(seed, ground=False, **settings)
        prior = result.problem.model.prior
        after.append(np.linalg.norm(prior.keypoints(result.coefficients) - truth, axis=1).mean())
        before.append(np.linalg.norm(prior.mean - truth, axis=1).mean())
    assert np.median(after) < 0.85 * np.median(before)


@pytest.mark.parametrize("strategy", StrategyName)
def test_every_strategy_runs(strategy):
    result = solved(2, strategy=strategy.value)
    weights, part = result.weights, result.graph().observations[0]
    assert result.failure is None
    assert np.degrees(rotation_angle(result.pose.matrix(), result.start.camera_T_object)) < 20
    assert ((weights.keypoints >= 0) & (weights.keypoints <= 1)).all()
    held = part.graph_weights(weights)
    if result.problem.energy.keypoints.strategy.loss is None:
        np.testing.assert_array_equal(held, weights.keypoints)
    else:
        assert (held >= weights.keypoints - 1e-12).all()  # the graph's own loss weighs again


@pytest.mark.parametrize("settings", [{}, {"joint": False}, {"free_offsets": True}])
def test_without_basis_vectors(settings):
    result = solved(4, basis_vectors=0, **settings)
    shape = result.problem.options.shape
    assert result.failure is None
    assert result.coefficients.shape == (0,)
    assert np.isfinite(result.pose.matrix()).all()
    if not shape.free_offsets:
        assert (result.offsets == 0).all()
    # Nothing is left to move at a fixed pose without offsets.
    stages = ["joint"] if shape.joint else ["shape"] if shape.free_offsets else []
    assert list(dict.fromkeys(iteration.stage for iteration in result.history)) == stages


def test_history_is_optional_and_changes_nothing():
    with_history, without = solved(2), solved(2, keep_history=False)
    assert with_history.history
    assert without.history == ()
    assert with_history.pose.matrix().tobytes() == without.pose.matrix().tobytes()
    assert with_history.coefficients.tobytes() == without.coefficients.tobytes()


def test_bit_for_bit():
    first, second = (solved(5, free_offsets=True) for _ in range(2))
    for name in ("coefficients", "offsets"):
        assert getattr(first, name).tobytes() == getattr(second, name).tobytes()
    for name in ("keypoints", "visibility", "box"):
        assert getattr(first.weights, name).tobytes() == getattr(second.weights, name).tobytes()
    assert first.energies == second.energies


@pytest.mark.parametrize("location", [(0.0, 1.65, -8.0), (0.0, 1.0, 0.5)], ids=["behind", "around the camera"])
def test_a_start_behind_the_camera_is_reported(location):
    """No step is taken from there: the state before comes back, with the reason."""
    problem, start = problem_of(0)
    pose = yaw_pose(0.3, location)
    result = solve(problem, replace(start, camera_T_object=pose, alternatives=()))
    assert "behind the camera" in result.failure
    np.testing.assert_array_equal(result.pose.matrix(), pose)
    np.testing.assert_array_equal(result.coefficients, start.coefficients)
    assert result.history == ()


@pytest.mark.parametrize("ground", [True, False])
def test_no_weight_at_all_leaves_the_prior(ground):
    """Where nothing was measured lambda goes to its prior's mean, and the pose no further than the ground pulls it."""
    problem, start = problem_of(0, size=False, box_model="off", ground=ground)
    start = replace(start, coefficients=np.linspace(-0.5, 0.5, 5))
    none = replace(problem.observation, keypoints=np.full((14, 2), np.nan), confidence=np.zeros(14))
    term = problem.energy.keypoints
    blind = replace(term, evidence=replace(term.evidence, measured=np.zeros(14, dtype=bool)))
    energy = replace(problem.energy, keypoints=blind)
    result = solve(replace(problem, observation=none, energy=energy), replace(start, alternatives=()))
    assert result.failure is None
    assert (result.weights.keypoints == 0).all()
    np.testing.assert_allclose(result.coefficients, 0.0, atol=1e-3)
    pose = result.pose.matrix()
    if ground:
        np.testing.assert_allclose(pose[:3, 1], problem.ground.normal, atol=1e-6)
        assert pose[:3, 3] @ problem.ground.normal == pytest.approx(problem.ground.distance, abs=1e-6)
        np.testing.assert_allclose(pose[[0, 2], 3], start.camera_T_object[[0, 2], 3], atol=0.01)
    else:
        np.testing.assert_array_equal(pose, start.camera_T_object)


def test_the_input_is_not_changed():
    problem, start = problem_of(6)
    names = ("camera_T_object", "coefficients", "weights", "visibility")
    before = {name: getattr(start, name).copy() for name in names}
    solve(problem, start)
    for name in names:
        np.testing.assert_array_equal(getattr(start, name), before[name])


def test_the_grounds_uncertainty_belongs_to_the_depth():
    problem, start = problem_of(1)
    ground, sigmas = problem.ground, []
    for depth in (8.0, 40.0):
        state = proposal(problem, replace(start, camera_T_object=yaw_pose(0.2, (0.0, 1.4, depth))))
        graph = graph_at(problem, state)
        values, pose = graph.values(state), state.poses[0]
        factor = terms_of(graph, state.weights[0])["ground"][0]
        sigmas.append((ground.normal @ pose.translation() - ground.distance) / factor.unwhitenedError(values)[0])
    assert sigmas == pytest.approx([np.hypot(ground.height_sigma, ground.slope_sigma * depth) for depth in (8, 40)])
    result = solve(problem, start)
    assert result.weights.depth == pytest.approx(result.pose.z(), abs=0.01)
