"""`fgrecon.Tracker` where something is unusual: terms that are off, factors that raise, cameras on their side."""

import re
from dataclasses import replace

import numpy as np
import pytest

import fgrecon
from fgrecon.core.errors import ContradictoryInputWarning, InvalidInputError
from tests.solve.time.streets import CAMERA, seen, upright
from tests.solve.time.test_tracker import GROUND, approaching, follow


def test_directions_that_are_not_to_count_change_nothing_over_time():
    rng, options = np.random.default_rng(5), fgrecon.Options(disabled_terms={"direction"})
    frames = [(0.1 * t, seen(pose, rng), None) for t, pose in enumerate(approaching(8))]
    wrong = [(t, replace(one, azimuth=np.roll(one.azimuth, len(one.azimuth) // 2)), at) for t, one, at in frames]
    without = [(t, replace(one, azimuth=None), at) for t, one, at in frames]
    for some, others in zip(follow(wrong, options=options), follow(without, options=options), strict=True):
        for one, other in zip(some, others, strict=True):
            np.testing.assert_array_equal(one.reconstruction.camera_T_object, other.reconstruction.camera_T_object)
            assert one.facing_probability == other.facing_probability


def test_a_frame_in_which_something_is_raised_leaves_nothing_behind():
    rng = np.random.default_rng(6)
    frames = [(0.1 * t, {name: seen(pose, rng) for name in (1, 2)}, None) for t, pose in enumerate(approaching(8))]
    broken = [False]

    def own(first, second, seconds, factor):
        if broken[0]:
            raise ZeroDivisionError
        return []

    tracker, other = (fgrecon.Tracker(size_prior="kitti", motion_factors=own) for _ in range(2))
    for number, (time, given, _) in enumerate(frames):
        if number == 4:
            broken[0] = True
            with pytest.raises(ZeroDivisionError):
                tracker.update(time, given, camera=CAMERA, ground=GROUND)
            broken[0] = False
            continue
        found = tracker.update(time, given, camera=CAMERA, ground=GROUND)
        expected = other.update(time, given, camera=CAMERA, ground=GROUND)
    for name, one in found.items():
        np.testing.assert_array_equal(one.reconstruction.camera_T_object, expected[name].reconstruction.camera_T_object)
        assert len(tracker.smooth()[name]) == len(frames) - 1


def test_times_in_milliseconds_are_warned_of_and_one_gap_is_not():
    rng, poses, tracker = np.random.default_rng(6), approaching(8), fgrecon.Tracker(size_prior="kitti")
    for time, pose in zip((0.0, 0.1, 20.0, 20.1), poses, strict=False):  # pytest makes warnings errors
        tracker.update(time, {1: seen(pose, rng)}, camera=CAMERA, ground=GROUND)
    tracker = fgrecon.Tracker(size_prior="kitti")
    for t, pose in enumerate(poses[:2]):
        tracker.update(100.0 * t, {1: seen(pose, rng)}, camera=CAMERA, ground=GROUND)
    with pytest.warns(ContradictoryInputWarning, match="Frames are 100 s apart"):
        tracker.update(200.0, {1: seen(poses[2], rng)}, camera=CAMERA, ground=GROUND)


def test_a_vehicle_that_goes_as_none_does_is_weak():
    """As at the times of a frame rate that is a thousand times too high."""
    rng = np.random.default_rng(6)
    frames = [(1e-4 * t, seen(pose, rng), None) for t, pose in enumerate(approaching(8))]
    last = follow(frames)[0][-1]
    assert last.reconstruction.status is fgrecon.Status.WEAK
    assert re.search(r"it goes \d{4,} m/s: are the times", last.reconstruction.reasons[-1])


def test_a_focal_length_that_is_not_known_is_refused():
    camera = replace(CAMERA, focal_sigma=0.3)
    observation = seen(approaching()[0], np.random.default_rng(7))
    with pytest.raises(InvalidInputError, match="camera: got focal length known to 30 %"):
        fgrecon.Tracker().update(0.0, {1: observation}, camera=camera)


@pytest.mark.filterwarnings("ignore::fgrecon.errors.ContradictoryInputWarning")
@pytest.mark.parametrize("roll", [88.5, 90.5, 120.0, 180.0])
def test_a_camera_that_lies_on_its_side_sees_no_ground(roll):
    """Of none that vehicles alone could tell: they are then as without one."""
    rng, turn = np.random.default_rng(8), np.eye(4)
    c, s = np.cos(np.radians(roll)), np.sin(np.radians(roll))
    turn[:2, :2] = [[c, -s], [s, c]]
    poses = [
        turn @ upright(yaw, [x, GROUND, z]) for yaw, x, z in ((0.3, -3.0, 14.0), (1.0, 0.5, 18.0), (2.0, 3.0, 12.0))
    ]
    tracker = fgrecon.Tracker(size_prior="kitti", shared_ground=True)
    for t in range(3):
        found = tracker.update(0.1 * t, {n: seen(pose, rng) for n, pose in enumerate(poses)}, camera=CAMERA)
        assert len(found) == 3
    scene = fgrecon.reconstruct_scene([seen(pose, rng) for pose in poses], CAMERA, size_prior="kitti")
    assert len(scene.vehicles) == 3
    if roll > 95.0:
        assert scene.ground is None


def test_keypoints_by_name_are_what_an_observation_of_them_is():
    observation = replace(seen(approaching()[4], np.random.default_rng(9)), box=None, azimuth=None)
    names = fgrecon.load_category("car14").keypoints
    triples = np.column_stack([observation.keypoints, observation.confidence])
    by_name = {name: row for name, row in zip(names, triples, strict=True) if np.isfinite(row).all()}
    for one, other in (
        [
            fgrecon.Tracker().update(0.0, {1: given}, camera=CAMERA)[1].reconstruction
            for given in (by_name, observation)
        ],
        [fgrecon.reconstruct_scene([given] * 2, CAMERA).vehicles[1] for given in (by_name, observation)],
    ):
        np.testing.assert_array_equal(one.camera_T_object, other.camera_T_object)
