"""The shape stage: where it ends, what it reports, and how it fails."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest

from fgrecon.core.robust import StrategyName
from fgrecon.io.catalogue import load_prior
from fgrecon.solve.graph.adjust import EARLY_TOLERANCE, adjust_shape
from fgrecon.solve.graph.graph import VehicleGraph, build
from fgrecon.solve.graph.solver import minimise
from fgrecon.solve.graph.state import graph_weights
from tests.cars import rotation_angle, yaw_pose
from tests.solve.graph.energy import minimise_by_scipy
from tests.solve.graph.support import energy_of, problem_of, weights_at


def adjust(seed=0, **settings):
    problem, start = problem_of(seed, **settings)
    return adjust_shape(problem, start), problem, start


@pytest.mark.parametrize("settings", [{}, {"joint": False}, {"free_offsets": True}])
@pytest.mark.parametrize("seed", [0, 1])
def test_the_result_is_the_minimum_for_its_weights(seed, settings):
    """Another solver, from the pose stage's result and with the final weights, ends at the same pose and lambda."""
    result, problem, start = adjust(seed, **settings)
    assert result.failure is None
    joint = problem.options.shape.joint
    energy = energy_of(problem, result.weights, result.box_weights, start.camera_T_object, joint=joint)
    x = minimise_by_scipy(energy, energy.start(start.coefficients, np.zeros((14, 3))))
    pose = energy.pose_at(x)
    np.testing.assert_allclose(result.pose.matrix(), pose, atol=2e-5)
    np.testing.assert_allclose(result.coefficients, energy.split(x)[1], atol=2e-4)
    points = problem.model.prior.keypoints(result.coefficients, result.offsets)
    np.testing.assert_allclose(points, energy.points_at(x), atol=1e-5)
    assert np.abs(result.coefficients - start.coefficients).max() > 2e-3  # which are not the start


@pytest.mark.parametrize("settings", [{}, {"joint": False}])
def test_stages(settings):
    result, problem, start = adjust(1, **settings)
    stages = [iteration.stage for iteration in result.history]
    assert stages == sorted(stages, key=["shape", "joint"].index)
    fixed = [iteration for iteration in result.history if iteration.stage == "shape"]
    for iteration in fixed:
        np.testing.assert_allclose(iteration.camera_T_object, start.camera_T_object, atol=1e-15)
    assert ("joint" in stages) is problem.options.shape.joint
    last = result.history[-1]
    np.testing.assert_array_equal(last.camera_T_object, result.pose.matrix())
    np.testing.assert_array_equal(last.coefficients, result.coefficients)
    np.testing.assert_array_equal(last.weights, result.weights)
    assert last.energies == result.energies


@pytest.mark.parametrize(("seed", "strategy"), [(3, "mixture"), (4, "huber"), (5, "paper"), (6, "gnc")])
def test_every_update_starts_where_the_last_one_ended_and_goes_down(seed, strategy):
    """Each update's weights are those at the end of the last one, and its steps those of a solve from there."""
    # Without planarity pose and lambda are all there is: the state is what the history holds.
    result, problem, start = adjust(seed, strategy=strategy, disabled_terms={"planarity"})
    by_update = {}
    for iteration in result.history:
        by_update.setdefault((iteration.stage, iteration.irls), []).append(iteration)
    assert list(dict.fromkeys(stage for stage, _ in by_update)) == ["shape", "joint"]
    assert len(by_update) > 4
    pose, coefficients, weights = start.camera_T_object, start.coefficients, start.weights
    for (stage, update), steps in by_update.items():
        assert [iteration.step for iteration in steps] == list(range(len(steps)))
        vehicle = VehicleGraph(problem, gtsam.Pose3(start.camera_T_object), pose_free=stage == "joint")
        values = vehicle.values(gtsam.Pose3(pose), coefficients, np.zeros((14, 3)))
        progress = update / (problem.options.strategy.updates - 1)
        weights, box_weights, visibility = weights_at(problem, pose, coefficients, previous=weights, progress=progress)
        np.testing.assert_allclose(steps[0].weights, weights, atol=1e-12)
        graph = build(vehicle.terms(graph_weights(problem.energy, weights, visibility), box_weights))
        path = minimise(graph, values, relative_tolerance=EARLY_TOLERANCE, record=True).path
        for mine, step in zip(path, steps, strict=False):  # the last update goes on for longer
            np.testing.assert_allclose(vehicle.read(mine)[0].matrix(), step.camera_T_object, atol=1e-8)
            np.testing.assert_allclose(vehicle.read(mine)[1], step.coefficients, atol=1e-8)
        assert len(steps) >= len(path) > 0
        errors = [graph.error(values)]
        for step in steps:
            at = vehicle.values(gtsam.Pose3(step.camera_T_object), step.coefficients, np.zeros((14, 3)))
            errors.append(graph.error(at))
        assert errors == sorted(errors, reverse=True)
        pose, coefficients = steps[-1].camera_T_object, steps[-1].coefficients


def test_the_shape_comes_closer_to_the_truth_than_the_mean():
    """Keypoints of random cars in the object frame: by 15 % in the median, without the pull towards the mean's form."""
    before, after = [], []
    for seed in range(12):
        rng = np.random.default_rng(seed)  # as `problem_of` draws them
        rng.uniform(size=3)
        truth = load_prior("car14").keypoints(rng.normal(size=5))
        settings = {"size": False, "sigma_relative": 0.01, "disabled_terms": {"laplacian"}}
        result, problem, _ = adjust(seed, ground=False, **settings)
        after.append(np.linalg.norm(problem.model.prior.keypoints(result.coefficients) - truth, axis=1).mean())
        before.append(np.linalg.norm(problem.model.prior.mean - truth, axis=1).mean())
    assert np.median(after) < 0.85 * np.median(before)


@pytest.mark.parametrize("strategy", StrategyName)
def test_every_strategy_runs(strategy):
    result, problem, start = adjust(2, strategy=strategy.value)
    assert result.failure is None
    assert np.degrees(rotation_angle(result.pose.matrix(), start.camera_T_object)) < 20
    assert ((result.weights >= 0) & (result.weights <= 1)).all()
    held = graph_weights(problem.energy, result.weights, result.visibility)
    if problem.energy.keypoints.strategy.loss is None:
        np.testing.assert_array_equal(held, result.weights)
    else:
        assert (held >= result.weights - 1e-12).all()  # the graph's own loss weighs again


@pytest.mark.parametrize("settings", [{}, {"joint": False}, {"free_offsets": True}])
def test_without_basis_vectors(settings):
    result, problem, *_ = adjust(4, basis_vectors=0, **settings)
    assert result.failure is None
    assert result.coefficients.shape == (0,)
    assert np.isfinite(result.pose.matrix()).all()
    if not problem.options.shape.free_offsets:
        assert (result.offsets == 0).all()
    stages = ["shape"] if problem.options.shape.free_offsets else []  # else nothing is left to move at a fixed pose
    stages += ["joint"] if problem.options.shape.joint else []
    assert list(dict.fromkeys(iteration.stage for iteration in result.history)) == stages


def test_history_is_optional_and_changes_nothing():
    with_history, *_ = adjust(2)
    without, *_ = adjust(2, keep_history=False)
    assert with_history.history
    assert without.history == ()
    assert with_history.pose.matrix().tobytes() == without.pose.matrix().tobytes()
    assert with_history.coefficients.tobytes() == without.coefficients.tobytes()


def test_bit_for_bit():
    first, second = (adjust(5, free_offsets=True)[0] for _ in range(2))
    for name in ("coefficients", "offsets", "weights", "visibility", "box_weights"):
        assert getattr(first, name).tobytes() == getattr(second, name).tobytes()
    assert first.energies == second.energies


@pytest.mark.parametrize("location", [(0.0, 1.65, -8.0), (0.0, 1.0, 0.5)], ids=["behind", "around the camera"])
def test_a_start_behind_the_camera_is_reported(location):
    """No step is taken from there: the state before comes back, with the reason."""
    problem, start = problem_of(0)
    pose = yaw_pose(0.3, location)
    result = adjust_shape(problem, replace(start, camera_T_object=pose))
    assert "behind the camera" in result.failure
    np.testing.assert_array_equal(result.pose.matrix(), pose)
    np.testing.assert_array_equal(result.coefficients, start.coefficients)
    assert result.history == ()


@pytest.mark.parametrize("ground", [True, False])
def test_no_weight_at_all_leaves_the_prior(ground):
    """Where nothing was measured lambda goes to its prior's mean, and the pose no further than the ground pulls it."""
    problem, start = problem_of(0, size=False, box_model="off", ground=ground)
    assert np.abs(start.coefficients).max() > 0.1
    none = replace(problem.observation, keypoints=np.full((14, 2), np.nan), confidence=np.zeros(14))
    term = problem.energy.keypoints
    blind = replace(term, evidence=replace(term.evidence, measured=np.zeros(14, dtype=bool)))
    energy = replace(problem.energy, keypoints=blind)
    result = adjust_shape(replace(problem, observation=none, energy=energy), start)
    assert result.failure is None
    assert (result.weights == 0).all()
    np.testing.assert_allclose(result.coefficients, 0.0, atol=1e-3)
    pose = result.pose.matrix()
    if ground:
        np.testing.assert_allclose(pose[:3, 1], problem.ground.normal, atol=1e-6)
        assert pose[:3, 3] @ problem.ground.normal == pytest.approx(problem.ground.distance, abs=1e-6)
        np.testing.assert_allclose(pose[[0, 2], 3], start.camera_T_object[[0, 2], 3], atol=0.01)
    else:
        np.testing.assert_array_equal(pose, start.camera_T_object)


def test_the_stage_does_not_change_its_input():
    problem, start = problem_of(6)
    names = ("camera_T_object", "coefficients", "weights", "visibility")
    before = {name: getattr(start, name).copy() for name in names}
    adjust_shape(problem, start)
    for name in names:
        np.testing.assert_array_equal(getattr(start, name), before[name])


def test_the_grounds_uncertainty_belongs_to_the_depth():
    problem, start = problem_of(1)
    sigmas = []
    for depth in (8.0, 40.0):
        pose = gtsam.Pose3(yaw_pose(0.2, (0.0, 1.4, depth)))
        vehicle = VehicleGraph(problem, pose, pose_free=True)
        values = vehicle.values(pose, start.coefficients, np.zeros((14, 3)))
        height = vehicle.terms(start.weights, np.ones(4))["ground"][0]
        residual = height.unwhitenedError(values)[0]
        assert residual == pytest.approx(problem.ground.normal @ pose.translation() - problem.ground.distance)
        sigmas.append(abs(residual) / np.sqrt(2.0 * height.error(values)))
    ground = problem.ground
    assert sigmas == pytest.approx([np.hypot(ground.height_sigma, ground.slope_sigma * depth) for depth in (8, 40)])
