"""ASPnP: its optimum against OpenCV and brute force, exactness, symmetries of the cost, ambiguity, errors."""

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from fgrecon.core.errors import DegenerateProblemError, InvalidInputError
from fgrecon.solve.proposals.aspnp import aspnp
from tests.solve.proposals.problems import aspnp_cost, random_problem

CUBE = np.array([[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])
SQUARE = np.array([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0]])
SEEDS = st.integers(0, 2**32 - 1)


def transform(rotation, translation):
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, translation
    return pose


def project(points, pose):
    in_camera = points @ pose[:3, :3].T + pose[:3, 3]
    return in_camera[:, :2] / in_camera[:, 2:]


def spread(problem):
    w = problem.repeats / problem.repeats.sum()
    return float(np.sqrt(w @ ((problem.image_points - w @ problem.image_points) ** 2).sum(axis=1)))


def angle(pose, other):
    return 2 * np.arcsin(
        np.clip(np.linalg.norm(pose[..., :3, :3] - other[..., :3, :3], axis=(-2, -1)) / np.sqrt(8), 0, 1)
    )


def brute_force(points, image_points, weights, rotations, iterations=50):
    """Levenberg-Marquardt on (rotation, log scale) from many rotations; written apart from the solver.

    Returns the rotations (B, 3, 3), scales 1 / depth of the centroid (B,), costs for weights of sum one (B,) and
    whether each start converged (B,).
    """
    w = weights / weights.sum()
    X = points - w @ points
    root = np.sqrt(w)[:, None]

    def residuals(R, scale):
        y = scale[:, None, None] * (X @ R.swapaxes(1, 2))  # relative to the centroid, which is at depth one
        raw = y[:, :, :2] - image_points * (1 + y[:, :, 2:])
        return y, root * (raw - (w[:, None] * raw).sum(axis=1, keepdims=True))

    R, scale = (
        rotations,
        np.full(len(rotations), 0.1 * np.sqrt(w @ (image_points**2).sum(axis=1) / (w @ (X**2).sum(axis=1)))),
    )
    damping = np.full(len(R), 1e-2)
    y, error = residuals(R, scale)
    cost = (error**2).sum(axis=(1, 2))
    axes = np.eye(3)
    for _ in range(iterations):
        turned = np.cross(axes[:, None, None], y[None])  # dy/drotation (3, B, N, 3)
        dy = np.concatenate([turned, y[None]])
        raw = dy[..., :2] - image_points * dy[..., 2:]
        J = root * (raw - (w[:, None] * raw).sum(axis=2, keepdims=True))
        gradient = np.einsum("kbnc,bnc->bk", J, error)
        H = np.einsum("kbnc,lbnc->bkl", J, J)
        H += (damping * np.trace(H, axis1=1, axis2=2))[:, None, None] * np.eye(4) + 1e-30 * np.eye(4)
        step = -np.linalg.solve(H, gradient[..., None])[..., 0]
        trial_R = Rotation.from_rotvec(step[:, :3]).as_matrix() @ R
        trial_scale = scale * np.exp(np.clip(step[:, 3], -1, 1))
        trial_y, trial_error = residuals(trial_R, trial_scale)
        trial_cost = (trial_error**2).sum(axis=(1, 2))
        better = trial_cost <= cost
        damping = np.where(better, np.maximum(damping / 5, 1e-15), np.minimum(damping * 5, 1e6))
        pick = better[:, None, None]
        R, y, error = np.where(pick, trial_R, R), np.where(pick, trial_y, y), np.where(pick, trial_error, error)
        scale, cost = np.where(better, trial_scale, scale), np.where(better, trial_cost, cost)
    return R, scale, cost, np.abs(step).max(axis=1) < 1e-7


def test_never_worse_than_sqpnp():
    rng = np.random.default_rng(1)
    compared = 0
    for _ in range(1000):
        problem = random_problem(rng)
        points, image_points = (np.repeat(a, problem.repeats, axis=0) for a in (problem.points, problem.image_points))
        best = aspnp(problem.points, problem.image_points, problem.repeats)[0]
        try:
            found, rotation, translation = cv2.solvePnP(points, image_points, np.eye(3), None, flags=cv2.SOLVEPNP_SQPNP)
        except cv2.error:
            continue
        pose = transform(cv2.Rodrigues(rotation)[0], translation[:, 0])
        if not found or np.mean(points @ pose[2, :3] + pose[2, 3] > 0) <= 0.5:
            continue
        compared += 1
        theirs = aspnp_cost(problem.points, problem.image_points, problem.repeats, pose)
        assert best.cost <= theirs + 1e-9 * problem.repeats.sum() * spread(problem) ** 2, problem
    assert compared > 950


def test_minima_are_those_of_brute_force():
    rng = np.random.default_rng(2)
    total = 0
    for index in range(50):
        problem = random_problem(rng)
        count = 3 if index % 10 == 0 else 12
        points, image_points, weights = problem.points[:count], problem.image_points[:count], problem.repeats[:count]
        solutions = aspnp(points, image_points, weights, tolerance=np.inf)
        poses = np.array([s.camera_T_object for s in solutions])
        R, scale, cost, converged = brute_force(
            points, image_points, weights, Rotation.random(500, rng=rng).as_matrix()
        )
        w = weights / weights.sum()
        level = w @ ((image_points - w @ image_points) ** 2).sum(axis=1)
        depth = 1 + scale[:, None] * ((points - w @ points) @ R[:, 2].T).T
        valid = ((depth > 0) @ w > 0.5) & (cost < level)
        costs = np.array([s.rms**2 for s in solutions])
        assert costs[0] <= cost[valid].min() + 1e-12 * level
        distances = angle(poses[:, None], R[None])
        near = distances.min(axis=0) < 1e-2
        assert near[valid & converged].all(), f"problem {index}: a minimum is missing"
        assert (distances[:, valid].min(axis=1) < 1e-2).all(), f"problem {index}: no minimum where one is reported"
        total += len(solutions)
    assert total > 60


@given(SEEDS)
@settings(max_examples=200, deadline=None, derandomize=True)
def test_exact_without_noise(seed):
    rng = np.random.default_rng(seed)
    problem = random_problem(rng)
    image_points = project(problem.points, problem.camera_T_object)
    solutions = aspnp(problem.points, image_points)
    errors = [np.abs(s.camera_T_object - problem.camera_T_object) for s in solutions]
    size = np.linalg.norm(problem.camera_T_object[:3, 3])
    assert min(e[:3, :3].max() + e[:3, 3].max() / size for e in errors) < 1e-6
    assert solutions[0].rms < 1e-10


@pytest.mark.parametrize("points", [CUBE, SQUARE, CUBE[[0, 3, 5, 6]]], ids=["cube", "square", "tetrahedron"])
@pytest.mark.parametrize("distance", [3.0, 30.0, 1000.0])
@pytest.mark.parametrize("diagonal", [(1, 1, 1), (1, -1, -1), (-1, 1, -1), (-1, -1, 1)])
def test_exact_at_special_rotations(points, distance, diagonal):
    pose = transform(np.diag(np.array(diagonal, dtype=float)), [0, 0, distance])
    solutions = aspnp(points, project(points, pose))
    # seen head-on from afar, a square hardly shows its tilt: the cost is of fourth order in it
    near = 1e-6 if len(points) != 4 or distance < 10 else 1e-2
    assert min(angle(s.camera_T_object, pose) for s in solutions) < near
    assert solutions[0].camera_T_object[:3, 3] == pytest.approx([0, 0, distance], rel=1e-4, abs=1e-4 * distance)


@given(SEEDS)
@settings(max_examples=60, deadline=None, derandomize=True)
def test_result_does_not_depend_on_the_object_frame(seed):
    rng = np.random.default_rng(seed)
    problem = random_problem(rng)
    solutions = aspnp(problem.points, problem.image_points, problem.repeats)
    unit = 10 ** rng.uniform(-3, 3)
    old_T_new = transform(Rotation.random(rng=rng).as_matrix(), rng.normal(size=3))
    points = unit * ((problem.points - old_T_new[:3, 3]) @ old_T_new[:3, :3])
    moved = aspnp(points, problem.image_points, problem.repeats)
    assert len(moved) == len(solutions)
    for ours, theirs in zip(moved, solutions, strict=True):
        expected = theirs.camera_T_object @ old_T_new
        assert ours.rms == pytest.approx(theirs.rms, rel=1e-6, abs=1e-10 * spread(problem))
        assert angle(ours.camera_T_object, expected) < 1e-4
        assert ours.camera_T_object[:3, 3] / unit == pytest.approx(
            expected[:3, 3], rel=1e-4, abs=1e-4 * np.abs(expected).max()
        )


@given(SEEDS)
@settings(max_examples=60, deadline=None, derandomize=True)
def test_integer_weights_repeat_points_and_zero_removes_them(seed):
    rng = np.random.default_rng(seed)
    problem = random_problem(rng)
    weights = rng.integers(1, 4, size=len(problem.points))
    weights[4:] *= rng.random(len(weights) - 4) < 0.8
    points, image_points = problem.points.copy(), problem.image_points.copy()
    repeated = aspnp(np.repeat(points, weights, axis=0), np.repeat(image_points, weights, axis=0))
    image_points[weights == 0] = np.nan
    weighted = aspnp(points, image_points, weights)
    assert len(weighted) == len(repeated)
    for ours, theirs in zip(weighted, repeated, strict=True):
        assert ours.cost == pytest.approx(theirs.cost, rel=1e-6, abs=1e-18)
        assert angle(ours.camera_T_object, theirs.camera_T_object) < 1e-4


def test_weights_change_only_the_scale_of_the_cost_by_a_factor():
    problem = random_problem(np.random.default_rng(3))
    one = aspnp(problem.points, problem.image_points, problem.repeats)[0]
    ten = aspnp(problem.points, problem.image_points, 10.0 * problem.repeats)[0]
    assert ten.cost == pytest.approx(10 * one.cost)
    assert ten.rms == pytest.approx(one.rms)


def test_weights_overrule_outliers():
    rng = np.random.default_rng(4)
    points = rng.uniform(-1, 1, size=(14, 3))
    pose = transform(Rotation.random(rng=rng).as_matrix(), [1, 0.5, 12])
    image_points = project(points, pose)
    image_points[:5] += 0.1 * rng.normal(size=(5, 2))
    weights = np.r_[np.full(5, 1e-8), np.ones(9)]
    assert angle(aspnp(points, image_points)[0].camera_T_object, pose) > 0.05
    assert angle(aspnp(points, image_points, weights)[0].camera_T_object, pose) < 1e-5


def test_cost_is_that_of_the_pose():
    rng = np.random.default_rng(5)
    for _ in range(50):
        problem = random_problem(rng)
        for solution in aspnp(problem.points, problem.image_points, problem.repeats, tolerance=np.inf):
            cost = aspnp_cost(problem.points, problem.image_points, problem.repeats, solution.camera_T_object)
            assert solution.cost == pytest.approx(cost, rel=1e-6, abs=1e-20)
            assert solution.rms == pytest.approx(np.sqrt(cost / problem.repeats.sum()), rel=1e-6, abs=1e-10)


def test_cost_is_the_reprojection_error_of_an_equally_distant_object():
    points = SQUARE * 0.5
    pose = transform(np.eye(3), [0.3, -0.2, 7.0])
    shift = np.array([[0.01, 0.0], [0.0, 0.02], [-0.01, 0.0], [0.0, 0.0]])
    cost = aspnp_cost(points, project(points, pose) + shift, None, pose)
    assert cost == pytest.approx(0.01**2 + 0.02**2 + 0.01**2)
    assert aspnp_cost(points, project(points, pose), None, transform(np.eye(3), [0, 0, -7.0])) == np.inf


def test_both_poses_of_a_far_planar_object():
    pose = transform(Rotation.from_euler("xy", [35, 20], degrees=True).as_matrix(), [0.5, 0.2, 60.0])
    rng = np.random.default_rng(6)
    image_points = project(SQUARE, pose) + 1e-4 * rng.normal(size=(4, 2))
    first, second = aspnp(SQUARE, image_points)
    assert first.cost <= second.cost
    assert min(angle(s.camera_T_object, pose) for s in (first, second)) < 0.05
    # the normals mirror each other about the line of sight
    sight = pose[:3, 3] / np.linalg.norm(pose[:3, 3])
    normals = [s.camera_T_object[:3, 2] for s in (first, second)]
    mirrored = 2 * (normals[0] @ sight) * sight - normals[0]
    assert abs(mirrored @ normals[1]) > 0.99
    assert len(aspnp(SQUARE, image_points, tolerance=0.0)) == 1


def test_three_points_give_every_pose_that_fits():
    rng = np.random.default_rng(7)
    counts = set()
    for _ in range(60):
        points = rng.normal(size=(3, 3))
        pose = transform(Rotation.random(rng=rng).as_matrix(), [*rng.uniform(-1, 1, 2), 5.0])
        image_points = project(points, pose)
        exact = [s for s in aspnp(points, image_points) if s.rms < 1e-9]
        assert min(angle(s.camera_T_object, pose) for s in exact) < 1e-5
        _, rotations, _ = cv2.solveP3P(points, image_points, np.eye(3), None, flags=cv2.SOLVEPNP_P3P)
        theirs = np.array([transform(cv2.Rodrigues(r)[0], [0, 0, 0]) for r in rotations])
        ours = np.array([s.camera_T_object for s in exact])
        assert (angle(theirs[:, None], ours[None]).min(axis=1) < 1e-3).all()
        counts.add(len(exact))
    assert {2, 4} <= counts <= {1, 2, 3, 4}


def test_a_point_behind_the_camera_is_reported():
    rng = np.random.default_rng(8)
    points = np.concatenate([rng.uniform(-1, 1, size=(9, 3)), [[0.2, 0.4, -6.0]]])
    pose = transform(np.eye(3), [0.1, 0.2, 4.0])
    best = aspnp(points, project(points, pose))[0]
    assert best.weight_in_front == pytest.approx(0.9)
    assert best.camera_T_object == pytest.approx(pose, abs=1e-8)
    assert aspnp(points[:9], project(points[:9], pose))[0].weight_in_front == 1


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ({"points": np.zeros((8, 2))}, "points"),
        ({"points": np.zeros(3)}, "points"),
        ({"image_points": np.zeros((7, 2))}, "image_points"),
        ({"image_points": np.zeros((8, 3))}, "image_points"),
        ({"image_points": "pixels"}, "image_points"),
        ({"points": np.where(np.arange(24).reshape(8, 3) == 4, np.nan, CUBE)}, "points[1, 1]"),
        ({"image_points": np.full((8, 2), np.inf)}, "image_points[0, 0]"),
        ({"weights": np.ones(7)}, "weights"),
        ({"weights": np.array([1, 1, 1, 1, 1, 1, 1, -1.0])}, "weights"),
        ({"weights": np.full(8, np.nan)}, "weights[0]"),
        ({"tolerance": -0.1}, "tolerance"),
        ({"tolerance": np.nan}, "tolerance"),
    ],
)
def test_bad_input_is_named(change, field):
    arguments = {"points": CUBE, "image_points": CUBE[:, :2] / (CUBE[:, 2:] + 5), "weights": np.ones(8)}
    with pytest.raises(InvalidInputError) as error:
        aspnp(**{**arguments, **change})
    assert error.value.field == field
    assert not isinstance(error.value, DegenerateProblemError)


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ({"weights": np.zeros(8)}, "weights"),
        ({"weights": np.r_[np.ones(2), np.zeros(6)]}, "weights"),
        ({"points": np.outer(np.arange(8.0), [1, 2, 3]) + 5}, "points"),
        ({"points": np.ones((8, 3))}, "points"),
        ({"weights": np.array([1, 1, 0, 0, 0, 0, 0, 0.0]) + np.eye(8)[0]}, "weights"),
        ({"image_points": np.full((8, 2), 0.3)}, "image_points"),
        (
            {"image_points": 0.1 * CUBE.prod(axis=1)[:, None] * [1.0, -1.0]},
            "image_points",
        ),  # no pose is better than none
    ],
)
def test_degenerate_problems_are_refused(change, field):
    arguments = {"points": CUBE, "image_points": CUBE[:, :2] / (CUBE[:, 2:] + 5), "weights": np.ones(8)}
    with pytest.raises(DegenerateProblemError) as error:
        aspnp(**{**arguments, **change})
    assert error.value.field == field
    assert error.value.fix


def test_small_problems_on_a_grid_never_break():
    """Coordinates from a handful of integers: repeated points, symmetries and roots that are not isolated."""
    rng = np.random.default_rng(9)
    solved = 0
    for _ in range(400):
        count = int(rng.integers(3, 9))
        points = rng.integers(-2, 3, size=(count, 3)) * [1.0, 1.0, rng.integers(2)]
        image_points = rng.integers(-2, 3, size=(count, 2)) * 10.0 ** rng.integers(-6, 1)
        try:
            solutions = aspnp(points, image_points)
        except DegenerateProblemError:
            continue
        solved += 1
        R = solutions[0].camera_T_object[:3, :3]
        assert np.abs(R.T @ R - np.eye(3)).max() < 1e-9
        assert np.linalg.det(R) == pytest.approx(1)
        assert solutions[0].camera_T_object[2] @ np.append(points.mean(axis=0), 1) > 0
    assert solved > 200
