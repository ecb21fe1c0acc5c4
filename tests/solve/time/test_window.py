"""Frames of a window: which are kept, and what is not known of the camera's motion between them."""

from collections import Counter

import gtsam
import numpy as np
import pytest

import fgrecon
from factors.noise import full_noise
from fgrecon.solve.time.frame import CameraDrift, FrameStep
from tests.solve.time.streets import CAMERA, seen, upright


def test_a_pose_is_as_unsure_as_the_motion_that_carries_it():
    """Against many motions drawn: how far the vehicle is off, in its own frame."""
    rng = np.random.default_rng(0)
    sigmas = np.array([1e-3, 2e-3, 5e-4, 0.01, 0.005, 0.1])
    pose = gtsam.Pose3(upright(0.8, [3.0, 1.6, 25.0]))
    step = FrameStep(0.1, gtsam.Pose3(), np.diag(sigmas**2))
    drawn = []
    for error in rng.normal(size=(20000, 6)) * sigmas:
        moved = gtsam.Pose3.Expmap(error).compose(pose)
        drawn.append(gtsam.Pose3.Logmap(pose.between(moved)))
    expected = np.cov(np.array(drawn).T)
    found = step.carried(pose)
    scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    np.testing.assert_allclose(found / scale, expected / scale, atol=0.05)


def test_two_steps_are_one():
    """Against the camera's way, which adds up its motions in the axes of its beginning."""
    rng, before, steps = np.random.default_rng(1), gtsam.Pose3(), []
    drift = begun = CameraDrift().moved(before, None)
    for _ in range(2):
        moved = gtsam.Pose3.Expmap(rng.normal(scale=[0.1, 0.3, 0.1, 0.2, 0.1, 1.5]))
        covariance = np.diag(rng.uniform(1e-6, 1e-2, 6))
        steps.append(FrameStep(0.1, moved, covariance))
        before = before.compose(moved)
        drift = drift.moved(before, covariance)
    both = steps[0].then(steps[1])
    assert both.seconds == pytest.approx(0.2)
    assert both.camera.equals(before, 1e-12)
    np.testing.assert_allclose(both.covariance, drift.since(begun, before), rtol=1e-9, atol=1e-15)
    assert steps[0].then(FrameStep(0.1, None, np.zeros((6, 6)))).camera is None


def test_a_cameras_way_of_many_kilometres_leaves_covariances_what_they_are():
    """What is known of a step is a small difference of large sums: it stays a covariance."""
    rng, place = np.random.default_rng(3), gtsam.Pose3()
    root = np.diag([1e-3] * 3 + [0.05] * 3) @ rng.normal(size=(6, 6))
    covariance = root @ root.T
    drift = CameraDrift().moved(place, None)
    for number in range(12_000):
        before = drift
        place = place.compose(gtsam.Pose3(gtsam.Rot3.Ry(2e-4 * np.sin(1e-3 * number)), np.array([0.0, 0.0, 1.0])))
        drift = drift.moved(place, covariance)
        found = drift.since(before, place)
        full_noise("motion", found + 1e-6 * np.eye(6))
    np.testing.assert_allclose(found, covariance, atol=0.05 * np.abs(covariance).max())


@pytest.mark.parametrize("window", [2, 3, 5, 7])
def test_a_window_is_the_last_two_frames_and_some_of_seconds(window):
    rng, tracker, known = np.random.default_rng(2), fgrecon.Tracker(size_prior="kitti", window=window), []
    for t in range(60):
        place = upright(0.002 * t, [0.0, 0.0, 0.05 * t])
        pose = np.linalg.inv(place) @ upright(0.8, [1.0, 1.65, 20.0])
        tracker.update(0.1 * t, {1: seen(pose, rng)}, camera=CAMERA, ground=1.65, world_T_camera=place)
        vehicle = tracker._tracks[1].vehicle
        known.append([one.image for one in vehicle.solved.parts])
        for before, frame in zip(vehicle.frames, vehicle.frames[1:], strict=False):
            assert frame.step.seconds == pytest.approx(frame.time - before.time)
            moved = upright(0.002 * before.number, [0.0, 0.0, 0.05 * before.number])
            moved = np.linalg.inv(moved) @ upright(0.002 * frame.number, [0.0, 0.0, 0.05 * frame.number])
            np.testing.assert_allclose(frame.step.camera.matrix(), moved, atol=1e-9)
    for t, numbers in enumerate(known[2 * window :], start=2 * window):
        assert (len(numbers), numbers[-2:]) == (window, [t - 1, t])
        assert t - numbers[0] <= 41
        if window > 3:
            assert t - numbers[0] >= min(t, 10)
            gaps = np.diff(numbers[:-1])
            assert gaps.max() <= max(0.75 * (t - numbers[0]), 2)


def test_the_graph_of_a_window_has_its_frames_and_what_ties_them():
    rng, tracker = np.random.default_rng(2), fgrecon.Tracker(size_prior="kitti", window=3)
    assert tracker.window_graph(3) == ()
    for t in range(5):
        pose = upright(1.4, [3.0, 1.65, 30.0 - 0.8 * t])
        tracker.update(0.1 * t, {3: seen(pose, rng)}, camera=CAMERA, world_T_camera=np.eye(4), ground=1.65)
    graph = tracker.window_graph(3)
    poses, velocities = ({v for f in graph for v in f.variables if v[0] == letter} for letter in "XV")
    assert len(poses) == len(velocities) == 3
    assert {"X(v=3,t=3)", "X(v=3,t=4)"} < poses
    labels = Counter(factor.label for factor in graph if factor.term == "extra")
    assert (labels["motion"], labels["velocity change"]) == (2, 2)
    assert labels["velocity"] >= 3
    assert set(labels) == {"motion", "velocity change", "velocity"}
    seen_in = [factor.variables for factor in graph if factor.term == "reprojection"]
    assert sorted(variables[0] for variables in seen_in) == sorted(poses)
    assert all("L(v=3)" in variables for variables in seen_in)
    tracker.forget(3)
    assert tracker.window_graph(3) == ()
