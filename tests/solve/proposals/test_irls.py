"""Algorithm 1 of the paper, and its local refinement against OpenCV and scipy."""

import cv2
import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from fgrecon.core.observation import Observation
from fgrecon.core.options import Options
from fgrecon.core.robust import RobustStrategy, StrategyName
from fgrecon.io.catalogue import load_prior
from fgrecon.solve.proposals.irls import algorithm1, refine_pose
from fgrecon.solve.proposals.problem import keypoint_covariances
from tests.cars import observe, pose_problem, project, rotation_angle, yaw_pose

PAPER = RobustStrategy(StrategyName.PAPER)


@pytest.fixture(scope="module")
def prior():
    return load_prior("car14")


def problem_of(prior, observation, robust=PAPER):
    return pose_problem(prior, observation, options=Options(strategy=robust))[0]


@pytest.mark.parametrize("degrees", range(0, 360, 45))
def test_exact_keypoints_give_the_exact_pose(prior, degrees):
    truth = yaw_pose(np.radians(degrees))
    observation = observe(prior, truth)
    result = algorithm1(problem_of(prior, observation))
    assert result.poses.shape == (6, 4, 4)
    assert result.weights.shape == (6, 14)
    for pose in result.poses:
        np.testing.assert_allclose(pose, truth, atol=1e-5)


def test_missing_keypoints_have_no_weight(prior):
    truth = yaw_pose(0.6)
    observation = observe(prior, truth, visible_only=True)
    result = algorithm1(problem_of(prior, observation))
    assert (result.weights[:, ~observation.measured] == 0).all()
    np.testing.assert_allclose(result.poses[-1], truth, atol=1e-4)


def test_weights_of_wrong_points_fall_and_the_pose_improves(prior):
    """Two sure points far off: each update trusts them less, and the pose comes closer to the truth."""
    truth = yaw_pose(-0.7)
    observation = observe(prior, truth)
    pixels, wrong = observation.keypoints.copy(), [1, 11]
    pixels[wrong] += [[40.0, -25.0], [-30.0, 30.0]]
    spoiled = Observation(pixels, np.full(14, 0.8), observation.box)
    result = algorithm1(problem_of(prior, spoiled))
    share = result.weights[:, wrong].sum(axis=1) / result.weights.sum(axis=1)
    assert share[-1] < 0.6 * share[0]
    errors = [rotation_angle(pose, truth) for pose in result.poses]
    assert errors[-1] < errors[0]
    literal = RobustStrategy(StrategyName.PAPER_LITERAL)
    printed = algorithm1(problem_of(prior, spoiled, literal))
    assert errors[-1] < rotation_angle(printed.poses[-1], truth)


@pytest.mark.parametrize("name", [StrategyName.PAPER, StrategyName.PAPER_LITERAL])
def test_every_update_is_equation_5_at_the_pose_before(prior, name):
    """Residuals and visibility are those of the pose before; the first weights know of no pose."""
    robust = RobustStrategy(name)
    observation = observe(prior, yaw_pose(-0.7), noise=3.0)
    problem = problem_of(prior, observation, robust)
    evidence = problem.energy.keypoints.evidence
    result = algorithm1(problem)
    np.testing.assert_allclose(result.weights[0], 0.5 * evidence.right + 0.5 * 0.5)
    sigma2 = keypoint_covariances(observation, problem.options.keypoints)[0, 0, 0]
    for pose, before, after in zip(result.poses[:-1], result.weights[:-1], result.weights[1:], strict=True):
        squared = np.square(project(prior.mean, pose) - observation.keypoints).sum(axis=1) / sigma2
        visibility = problem.model.visibility.lookup(pose)
        np.testing.assert_allclose(after, robust.evaluate(squared, evidence, visibility, previous=before)[0], atol=1e-9)


@pytest.mark.parametrize("updates", [0, 1, 5])
def test_the_number_of_updates(prior, updates):
    observation = observe(prior, yaw_pose(0.3), noise=2.0)
    robust = RobustStrategy(StrategyName.PAPER, updates=updates)
    result = algorithm1(problem_of(prior, observation, robust))
    assert len(result.poses) == len(result.weights) == updates + 1


def test_warm_starts_end_where_global_solves_do(prior):
    for seed in range(6):
        observation = observe(prior, yaw_pose(seed), noise=3.0, seed=seed)
        problem = problem_of(prior, observation)
        warm = algorithm1(problem)
        cold = algorithm1(problem, every_solve_global=True)
        assert rotation_angle(warm.poses[-1], cold.poses[-1]) < np.radians(1.0)


def random_case(seed, noise=0.003):
    """Points before a camera with K = I, and a start some degrees and decimetres off."""
    rng = np.random.default_rng(seed)
    points = rng.uniform(-1, 1, (14, 3)) * [2.0, 0.75, 0.8]
    pose = np.eye(4)
    pose[:3, :3] = Rotation.random(rng=rng).as_matrix()
    pose[:3, 3] = rng.normal([0.5, 0.3, 10.0], 1.0)
    in_camera = points @ pose[:3, :3].T + pose[:3, 3]
    rays = in_camera[:, :2] / in_camera[:, 2:] + noise * rng.normal(size=(14, 2))
    start = pose.copy()
    start[:3, :3] = pose[:3, :3] @ Rotation.from_rotvec(0.1 * rng.normal(size=3)).as_matrix()
    start[:3, 3] += 0.2 * rng.normal(size=3)
    return points, rays, start, rng.uniform(0.01, 1.0, 14)


def weighted_cost(points, rays, weights, pose):
    in_camera = points @ pose[:3, :3].T + pose[:3, 3]
    return weights @ np.square(in_camera[:, :2] / in_camera[:, 2:] - rays).sum(axis=1)


@pytest.mark.parametrize("seed", range(10))
def test_refinement_against_opencv(seed):
    points, rays, start, _ = random_case(seed)
    found = refine_pose(points, rays, np.ones(14), start, iterations=30)
    rotation, translation = cv2.solvePnPRefineLM(
        points,
        rays,
        np.eye(3),
        None,
        cv2.Rodrigues(start[:3, :3])[0],
        start[:3, 3].copy(),
        criteria=(cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 200, 1e-15),
    )
    theirs = np.eye(4)
    theirs[:3, :3], theirs[:3, 3] = cv2.Rodrigues(rotation)[0], translation.ravel()
    mine, other = (weighted_cost(points, rays, np.ones(14), pose) for pose in (found, theirs))
    assert mine <= other * (1 + 1e-9)
    if other <= mine * (1 + 1e-9):  # OpenCV has converged as well: then to the same pose
        np.testing.assert_allclose(found, theirs, atol=1e-4)


@pytest.mark.parametrize("seed", range(10))
def test_weighted_refinement_against_scipy(seed):
    points, rays, start, weights = random_case(seed, noise=0.01)
    found = refine_pose(points, rays, weights, start, iterations=30)

    def residual(x):
        in_camera = Rotation.from_rotvec(x[:3]).apply(points) + x[3:]
        return (np.sqrt(weights)[:, None] * (in_camera[:, :2] / in_camera[:, 2:] - rays)).ravel()

    x0 = np.concatenate([Rotation.from_matrix(start[:3, :3]).as_rotvec(), start[:3, 3]])
    oracle = least_squares(residual, x0, xtol=1e-15, ftol=1e-15, gtol=1e-15)
    assert weighted_cost(points, rays, weights, found) == pytest.approx(2 * oracle.cost, rel=1e-9)
    np.testing.assert_allclose(found[:3, 3], oracle.x[3:], atol=1e-5)
    np.testing.assert_allclose(found[:3, :3], Rotation.from_rotvec(oracle.x[:3]).as_matrix(), atol=1e-6)


@pytest.mark.parametrize("iterations", [0, 1, 3])
def test_refinement_never_costs_more_than_its_start(iterations):
    for seed in range(20):
        points, rays, start, weights = random_case(seed, noise=0.05)
        found = refine_pose(points, rays, weights, start, iterations)
        assert weighted_cost(points, rays, weights, found) <= weighted_cost(points, rays, weights, start)
        np.testing.assert_allclose(found[:3, :3] @ found[:3, :3].T, np.eye(3), atol=1e-12)
