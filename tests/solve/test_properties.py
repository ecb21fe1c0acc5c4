"""What must hold of any solve: another frame, order or scale changes what it says and nothing else."""

from contextlib import suppress
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import fgrecon
from benchmarks.soak.problems import problem
from benchmarks.soak.watch import watched
from fgrecon.core.camera import Camera
from fgrecon.core.errors import FgreconError
from fgrecon.core.observation import Observation
from fgrecon.core.options import Options
from fgrecon.core.robust import RobustStrategy
from fgrecon.io.catalogue import load_prior
from fgrecon.solve.scene import reconstruct_scene
from tests.cars import CAMERA, observe, yaw_pose

pytestmark = pytest.mark.filterwarnings("ignore::fgrecon.errors.ContradictoryInputWarning")  # mirrored

PRIOR = load_prior("car14")
FAST = Options(keep_history=False, box="cuboid")
KNOWN = Camera.of(CAMERA)
MIRROR = np.diag([-1.0, 1.0, 1.0, 1.0])
FLIP = np.diag([1.0, 1.0, -1.0, 1.0])  # left and right of the car
few = settings(max_examples=15, deadline=None, derandomize=True)
seeds = st.integers(0, 10**6)


def car(seed):
    """A car of any yaw, place and shape, with noisy keypoints."""
    rng = np.random.default_rng(seed)
    location = np.array([rng.uniform(-5, 5), 1.65, rng.uniform(8, 30)])
    pose = yaw_pose(rng.uniform(-np.pi, np.pi), location)
    return observe(PRIOR, pose, 0.7 * rng.normal(size=5), noise=1.0, seed=seed)


def solve(observation, camera=KNOWN, **inputs):
    inputs = {"ground": 1.65, "size_prior": "kitti", "options": FAST} | inputs
    return fgrecon.reconstruct(observation, camera, **inputs)


def close(found, wanted, scale=1.0):
    """The same pose, to what the solver's tolerance leaves."""
    np.testing.assert_allclose(found[:3, :3], wanted[:3, :3], atol=2e-5)
    np.testing.assert_allclose(found[:3, 3], wanted[:3, 3], atol=2e-4 * scale)


def settled(result):
    """Whether there is one minimum: where two are nearly as good, rounding may choose."""
    return all(other.excess > 0.05 for other in result.uncertainty.alternatives) and result.status.value in (
        "converged",
        "ambiguous",
    )


@few
@given(seeds, st.floats(0.25, 4.0))
def test_scaled_pixels_and_intrinsics_change_nothing(seed, scale):
    """All but a pixel's own noise, which is therefore left out."""
    exact = replace(
        FAST, keypoints=replace(FAST.keypoints, sigma_pixels=1e-3), box=replace(FAST.box, sigma_pixels=1e-3)
    )
    seen = car(seed)
    inputs = {"ground": 1.65, "size_prior": "kitti", "options": exact}
    one = fgrecon.reconstruct(seen, KNOWN, **inputs)
    larger = replace(seen, keypoints=seen.keypoints * scale, box=None if seen.box is None else seen.box * scale)
    matrix = np.diag([scale, scale, 1.0]) @ KNOWN.matrix
    other = fgrecon.reconstruct(larger, Camera(matrix), **inputs)
    if settled(one):
        close(other.camera_T_object, one.camera_T_object)


@few
@given(seeds)
def test_a_picture_upside_down_turns_the_pose(seed):
    """Without a ground; by a half turn, since the noise goes by the upright box of the points."""
    square = Camera.of([700.0, 700.0, 600.0, 180.0])
    seen = Observation(car(seed).keypoints, car(seed).confidence)
    upside_down = replace(seen, keypoints=2.0 * np.array([600.0, 180.0]) - seen.keypoints)
    one, other = (solve(points, square, ground=None) for points in (seen, upside_down))
    if settled(one) and settled(other):
        close(other.camera_T_object, np.diag([-1.0, -1.0, 1.0, 1.0]) @ one.camera_T_object)


@few
@given(seeds, st.sampled_from(["off", "cuboid", "surface", "detected"]))
def test_a_mirrored_picture_mirrors_the_pose(seed, box):
    """The car's left points become its right ones."""
    seen = car(seed)
    centred = Camera.of([700.0, 700.0, 0.0, 180.0])
    pixels, (left, top, right, bottom) = seen.keypoints - [600.0, 0.0], seen.box - [600.0, 0.0, 600.0, 0.0]
    mirror = PRIOR.category.mirror
    flipped = Observation(pixels[mirror] * [-1.0, 1.0], seen.confidence[mirror], [-right, top, -left, bottom])
    as_it_is = Observation(pixels, seen.confidence, [left, top, right, bottom])
    one, other = (solve(given, centred, options=replace(FAST, box=box)) for given in (as_it_is, flipped))
    assert PRIOR.is_symmetric
    if settled(one):
        close(other.camera_T_object, MIRROR @ one.camera_T_object @ FLIP)


@few
@given(seeds, st.tuples(st.floats(-300, 300), st.floats(-100, 100)))
def test_a_part_of_a_picture_says_what_the_picture_says(seed, corner):
    """Pixels and principal point count from another corner."""
    seen, matrix = car(seed), KNOWN.matrix.copy()
    matrix[:2, 2] -= corner
    moved = replace(seen, keypoints=seen.keypoints - corner, box=seen.box - np.tile(corner, 2))
    whole, part = solve(seen, Camera(KNOWN.matrix)), solve(moved, Camera(matrix))
    if settled(whole):
        close(part.camera_T_object, whole.camera_T_object)
        assert part.status is whole.status


@few
@given(seeds, st.integers(2, 5))
def test_a_track_backwards_is_the_same_track(seed, count):
    rng = np.random.default_rng(seed)
    poses = [yaw_pose(0.3 + 0.1 * t, (2.0 * t - 3.0, 1.65, 14.0 + t)) for t in range(count)]
    seen = [observe(PRIOR, pose, 0.7 * rng.normal(size=5), noise=1.0, seed=seed + t) for t, pose in enumerate(poses)]
    forwards, backwards = (fgrecon.reconstruct_track(some, KNOWN, options=FAST) for some in (seen, seen[::-1]))
    assert backwards.status is forwards.status
    for one, other in zip(forwards.frames, backwards.frames[::-1], strict=True):
        if settled(one):
            close(other.camera_T_object, one.camera_T_object)


@few
@given(seeds, seeds)
def test_the_order_of_a_scenes_cars_does_not_matter(seed, order):
    seen = [car(seed + i) for i in range(3)]
    turn = np.random.default_rng(order).permutation(3)
    one = reconstruct_scene(seen, KNOWN, ground=1.65, size_prior="kitti", options=FAST)
    other = reconstruct_scene([seen[i] for i in turn], KNOWN, ground=1.65, size_prior="kitti", options=FAST)
    for place, i in enumerate(turn):
        if settled(one.vehicles[i]):
            close(other.vehicles[place].camera_T_object, one.vehicles[i].camera_T_object, scale=10.0)


@few
@given(seeds, st.integers(0, 13))
def test_a_point_that_was_not_measured_may_lie_anywhere(seed, point):
    """What is NaN has no confidence, whatever was written for it."""
    seen = car(seed)
    pixels = seen.keypoints.copy()
    pixels[point] = np.nan
    confidences = np.tile(seen.confidence, (2, 1))
    confidences[0, point], confidences[1, point] = 0.9, 0.0
    one, other = (solve(Observation(pixels, confidence, seen.box)) for confidence in confidences)
    np.testing.assert_array_equal(one.camera_T_object, other.camera_T_object)


@pytest.mark.parametrize("seed", range(4))
def test_a_car_that_is_given_twice_is_found_twice(seed):
    seen = [car(seed), car(seed)]
    inputs = {"ground": 1.65, "size_prior": "kitti", "options": FAST}
    first, second = reconstruct_scene(seen, KNOWN, **inputs).vehicles
    close(first.camera_T_object, second.camera_T_object)


@settings(max_examples=8, deadline=None, derandomize=True)
@given(seeds)
def test_no_step_raises_the_energy(seed):
    """Of cars, scenes and tracks that are mostly nonsense, visibility held."""
    _, _, solve = problem([seed, 0])
    with watched() as watch, suppress(FgreconError):
        solve()
    assert watch.rises == 0


@pytest.mark.parametrize("strategy", ["huber", "cauchy", "geman_mcclure", "tukey"])
def test_no_update_raises_the_energy(strategy):
    with watched() as watch:
        solve(car(11), options=replace(FAST, strategy=RobustStrategy(strategy)))
    assert watch.steps > 2
    assert watch.rises == 0


def test_steps_are_watched():
    with watched() as watch:
        solve(car(3))
    assert watch.steps > 5
    watch.look(10.0, 10.1)
    assert watch.rises == 1
