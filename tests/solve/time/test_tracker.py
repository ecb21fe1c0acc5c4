"""`fgrecon.Tracker` on made-up streets whose poses are known."""

import copy
import pickle
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest

import fgrecon
from factors.native import native
from fgrecon.core.errors import InvalidInputError
from tests.solve.time.streets import CAMERA, off, seen, upright

GROUND = 1.65


def follow(frames, **options):
    """Online estimates of vehicle 3, and those of the end; frames are (time, pose or None, observation, camera)."""
    tracker = fgrecon.Tracker(size_prior="kitti", **options)
    online = []
    for time, observation, world_T_camera in frames:
        given = {} if observation is None else {3: observation}
        online += tracker.update(time, given, camera=CAMERA, world_T_camera=world_T_camera, ground=GROUND).values()
    return online, tracker.smooth()[3]


def approaching(count=24, speed=8.0):
    """Poses of a car that comes along, a little faster in the camera than it drives."""
    return [upright(1.4 - 0.004 * t, [3.0 + 0.02 * t, GROUND, 32.0 - 0.1 * speed * t]) for t in range(count)]


def test_a_track_of_one_frame_is_a_single_image():
    observation = seen(approaching()[0], np.random.default_rng(0))
    online, smoothed = follow([(0.0, observation, None)])
    alone = fgrecon.reconstruct(observation, CAMERA, ground=GROUND, size_prior="kitti")
    for (estimate,) in (online, smoothed):
        result = estimate.reconstruction
        np.testing.assert_array_equal(result.camera_T_object, alone.camera_T_object)
        np.testing.assert_array_equal(result.shape.coefficients, alone.shape.coefficients)
        np.testing.assert_array_equal(result.uncertainty.pose_covariance, alone.uncertainty.pose_covariance)
        assert (result.status, result.message) == (alone.status, alone.message)
        assert estimate.velocity is None
        assert estimate.velocity_covariance is None
        assert estimate.facing_probability > 0.8


def test_estimates_that_nobody_wants_change_nothing():
    rng = np.random.default_rng(3)
    observations = [seen(pose, rng) for pose in approaching(9)]
    wanted, others = fgrecon.Tracker(size_prior="kitti"), fgrecon.Tracker(size_prior="kitti")
    assert wanted.placed(3) is None
    for t, observation in enumerate(observations):
        given = {"camera": CAMERA, "ground": GROUND}
        result = wanted.update(t / 10, {3: observation}, **given)[3].reconstruction
        assert others.update(t / 10, {3: observation}, **given, estimated=False) == {}
        for tracker in (wanted, others):
            pose, points = tracker.placed(3)
            np.testing.assert_array_equal(pose, result.camera_T_object)
            np.testing.assert_array_equal(points, result.wireframe)
    for one, other in zip(wanted.smooth()[3], others.smooth()[3], strict=True):
        assert one.reconstruction.to_dict() == other.reconstruction.to_dict()


@pytest.mark.parametrize("row", [False, True], ids=["one by one", "five in a row"])
def test_frames_that_are_flipped_or_missing(row):
    """Of every ten frames three are missing; every fourth of the others is flipped, and once five in a row.

    One that is turned turns no vehicle. Several that are all sure may be right, until others follow: what was before
    may be wrong alike.
    """
    rng = np.random.default_rng(1)
    poses = approaching(36)
    frames, truth = [], []
    for t, pose in enumerate(poses):
        if t % 10 in (4, 6, 9):
            continue
        flipped = t in (3, 12, 17, 30, 33) or (row and 20 <= t <= 25)
        frames.append((0.1 * t, seen(pose, rng, turned=flipped), None))
        truth.append(pose)
    online, smoothed = follow(frames)
    wrong = [off(estimate, pose)[0] > 20.0 for estimate, pose in zip(online, truth, strict=True)]
    assert not any(one and not (row and 2.0 <= frame[0] <= 3.0) for one, frame in zip(wrong, frames, strict=True))
    assert sum(wrong) <= 4 * row
    assert max(off(estimate, pose)[0] for estimate, pose in zip(smoothed, truth, strict=True)) < 15.0
    assert smoothed[10].facing_probability > (0.9 if row else 0.99)
    assert [one.time for one in smoothed] == [one.time for one in online]


def test_a_turned_first_frame_is_mended_by_those_after():
    rng = np.random.default_rng(2)
    poses = approaching(12)
    frames = [(0.1 * t, seen(pose, rng, turned=t < 2), None) for t, pose in enumerate(poses)]
    online, smoothed = follow(frames)
    assert off(online[0], poses[0])[0] > 150.0
    assert off(online[-1], poses[-1])[0] < 10.0
    assert max(off(estimate, pose)[0] for estimate, pose in zip(smoothed, poses, strict=True)) < 10.0
    assert len({tuple(one.reconstruction.shape.coefficients) for one in smoothed}) == 1


@pytest.mark.parametrize("moving", [False, True], ids=["camera stands", "camera drives"])
def test_parked_cars_stand(moving):
    """0.3 m over their track, once all frames are there; the turn of the camera is no turn of theirs."""
    rng = np.random.default_rng(3)
    parked = [upright(1.5, [4.0, GROUND, 24.0]), upright(-1.6, [-4.0, GROUND, 28.0])]
    tracker, places = fgrecon.Tracker(size_prior="kitti"), []
    for t in range(20):
        world_T_camera = upright(0.004 * t, [0.02 * t, 0.0, 0.5 * t]) if moving else np.eye(4)
        places.append(world_T_camera)
        given = {i: seen(np.linalg.inv(world_T_camera) @ pose, rng) for i, pose in enumerate(parked)}
        online = tracker.update(0.1 * t, given, camera=CAMERA, world_T_camera=world_T_camera, ground=GROUND)
    for number, past in tracker.smooth().items():
        standing = np.array([one.world_T_object[:3, 3] for one in past])
        assert np.linalg.norm(standing - standing.mean(axis=0), axis=1).max() < 0.3
        np.testing.assert_allclose(places[-1] @ past[-1].reconstruction.camera_T_object, past[-1].world_T_object)
        assert max(one.speed for one in past) < 0.5
        assert online[number].speed < 1.0


def passed_by(shape, speed, seed):
    """Frames and poses of a car 35 m ahead, seen by a camera that drives towards it at 10 m/s."""
    rng, frames, poses = np.random.default_rng(seed), [], []
    for t in range(25):
        world_T_camera = upright(0.0, [0.0, 0.0, 1.0 * t])
        poses.append(np.linalg.inv(world_T_camera) @ upright(-np.pi / 2.0, [4.0, GROUND, 35.0 + 0.1 * speed * t]))
        frames.append((0.1 * t, seen(poses[-1], rng, noise=0.01, shape=shape), world_T_camera))
    return frames, poses


def test_past_parked_cars_the_way_tells_their_distance():
    """Which sizes and a level ground tell less exactly: the prior's cars are smaller and larger than the fleet's."""
    with_motion, without = [], []
    for seed, first in enumerate((-1.2, 1.2)):
        frames, poses = passed_by([first, 0.0, 0.0, 0.0, 0.0], 0.0, seed)
        for found, given in ((with_motion, frames), (without, [(time, one, None) for time, one, _ in frames])):
            _, smoothed = follow(given)
            found += [off(one, pose)[1] for one, pose in zip(smoothed, poses, strict=True)]
    assert np.mean(with_motion) < 0.75 * np.mean(without)


@pytest.mark.parametrize("speed", [4.0, 8.0, -8.0])
def test_a_car_that_drives_is_not_taken_to_stand(speed):
    frames, poses = passed_by(None, speed, 5)
    online, smoothed = follow([frame for frame, pose in zip(frames, poses, strict=True) if pose[2, 3] > 8.0])
    assert online[-1].velocity[2] == pytest.approx(speed, abs=2.0)
    assert smoothed[len(smoothed) // 2].velocity[2] == pytest.approx(speed, abs=1.5)


def test_velocity_is_over_the_world_where_it_is_known():
    rng = np.random.default_rng(4)
    frames = []
    for t in range(25):
        world_T_camera = upright(0.0, [0.0, 0.0, 1.0 * t])  # 10 m/s ahead
        car = upright(-np.pi / 2.0, [3.0, GROUND, 15.0 + 1.2 * t])  # 12 m/s, before it
        frames.append((0.1 * t, seen(np.linalg.inv(world_T_camera) @ car, rng), world_T_camera))
    _, smoothed = follow(frames)
    np.testing.assert_allclose(smoothed[12].velocity, [0.0, 0.0, 12.0], atol=0.6)
    assert abs(smoothed[12].turn_rate) < 0.1
    off = smoothed[12].velocity - np.array([0.0, 0.0, 12.0])
    assert off @ np.linalg.solve(smoothed[12].velocity_covariance, off) < 16.0  # chi-square of 3: 0.1 % are above
    assert smoothed[12].velocity_covariance[2, 2] < 1.0
    _, relative = follow([(time, observation, None) for time, observation, _ in frames])
    np.testing.assert_allclose(relative[12].velocity, [0.0, 0.0, 2.0], atol=0.8)
    assert relative[12].world_T_object is None


def test_a_velocity_whose_spread_cannot_be_had_has_none(monkeypatch):
    monkeypatch.setattr("fgrecon.solve.time.window.marginals_of", lambda *_, **__: None)
    rng = np.random.default_rng(9)
    online, _ = follow([(0.1 * t, seen(pose, rng), None) for t, pose in enumerate(approaching(3))])
    assert online[-1].velocity is not None
    assert online[-1].velocity_covariance is None


def test_a_shared_ground_is_found_by_the_frame_that_shows_it():
    """Two vehicles on a slope: their first frame stands on it already, and agrees with a scene of both."""
    rng = np.random.default_rng(12)
    slope = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, -0.02], [0.0, 0.02, 1.0]])
    lifted = {}
    for name, pose in enumerate([upright(0.3, [-3.0, GROUND, 12.0]), upright(1.4, [3.0, GROUND, 25.0])]):
        tilted = pose.copy()
        tilted[:3, 3] = slope @ pose[:3, 3]
        lifted[name] = seen(tilted, rng)
    tracker = fgrecon.Tracker(size_prior="kitti", shared_ground=True)
    found = tracker.update(0.0, lifted, camera=CAMERA, ground=GROUND)
    scene = fgrecon.reconstruct_scene(list(lifted.values()), CAMERA, ground=GROUND, size_prior="kitti")
    for name, result in zip(scene.numbers, scene.vehicles, strict=True):
        place = found[name].reconstruction.location
        assert np.linalg.norm(place - result.location) < 0.3
        assert result.location[1] < GROUND


def test_it_is_better_than_single_images():
    rng = np.random.default_rng(5)
    poses = approaching(30)
    given = [seen(pose, rng, noise=0.04) for pose in poses]
    online, smoothed = follow([(0.1 * t, one, None) for t, one in enumerate(given)])
    alone = [fgrecon.reconstruct(one, CAMERA, ground=GROUND, size_prior="kitti") for one in given]
    ways = [
        np.array([result.location - pose[:3, 3] for result, pose in zip(some, poses, strict=True)])
        for some in (alone, [one.reconstruction for one in online], [one.reconstruction for one in smoothed])
    ]
    single, by_track, at_the_end = (np.linalg.norm(way, axis=1).mean() for way in ways)
    assert by_track < single
    assert at_the_end < single
    jitter = [np.linalg.norm(np.diff(way, axis=0), axis=1).mean() for way in ways]
    assert jitter[1] < 0.6 * jitter[0]
    assert jitter[2] < 0.5 * jitter[1]


def test_rounding_decides_nothing():
    """Also of a vehicle that no car's shape fits: a window that ends on the way hands its state to the next one.

    One of three such tracks may stand where two results are equally good, and rounding decides between them.
    """
    unlike, apart = np.array([-6.0, 0.0, 0.0, 0.0, 0.0]), []
    for seed in range(3):
        found = []
        for least in (0.0, 1e-9):
            rng, tracker, places = np.random.default_rng(seed), fgrecon.Tracker(size_prior="kitti"), []
            for t in range(12):
                one = seen(upright(-1.5, [-3.0, 1.65, 45.0 - 2.5 * t]), rng, noise=0.06, shape=unlike)
                one = replace(one, keypoints=one.keypoints + least * np.cos(np.arange(28.0)).reshape(14, 2))
                places.append(tracker.update(0.2 * t, {1: one}, camera=CAMERA, ground=1.65)[1].reconstruction.location)
            smoothed = [one.reconstruction.location for one in tracker.smooth()[1]]
            found.append(np.array([*places, *smoothed]))
        apart.append(np.abs(found[0] - found[1]).max())
    assert sorted(apart)[1] < 1e-5


@pytest.mark.parametrize("begun", [1.0, 1.7e9])
def test_when_the_clock_begins_changes_nothing(begun):
    """Of a steady clock frames are equally far apart, however its times are rounded: nothing is decided by that."""
    ends = []
    for start in (0.0, begun):
        rng, tracker, places = np.random.default_rng(2), fgrecon.Tracker(size_prior="kitti"), []
        for t, pose in enumerate(approaching(16)):
            given = {1: seen(pose, rng)}
            estimate = tracker.update(start + 0.1 * t, given, camera=CAMERA, ground=GROUND)[1]
            places.append(estimate.reconstruction.location)
        ends.append(np.array([*places, *(one.reconstruction.location for one in tracker.smooth()[1])]))
    np.testing.assert_allclose(ends[0], ends[1], atol=1e-3)


def test_what_is_kept_does_not_grow():
    rng = np.random.default_rng(6)
    pose = upright(0.8, [1.0, GROUND, 15.0])
    tracker = fgrecon.Tracker(size_prior="kitti", past=7, window=3)
    for t in range(20):
        tracker.update(0.1 * t, {1: seen(pose, rng)}, camera=CAMERA, ground=GROUND)
        assert len(tracker._tracks[1].vehicle.frames) <= 3
    assert [round(one.time, 1) for one in tracker.smooth()[1]] == [1.3, 1.4, 1.5, 1.6, 1.7, 1.8, 1.9]
    tracker.forget(1)
    assert tracker.smooth() == {}


def test_vehicles_that_cannot_be_solved_are_refused():
    rng = np.random.default_rng(7)
    good = seen(upright(0.8, [1.0, GROUND, 15.0]), rng)
    empty = fgrecon.Observation(np.full((14, 2), np.nan), np.zeros(14))
    tracker = fgrecon.Tracker(size_prior="kitti")
    found = tracker.update(0.0, {1: good, 2: empty}, camera=CAMERA, ground=GROUND)
    assert (set(found), set(tracker.refused)) == ({1}, {2})
    again = tracker.update(0.1, {1: empty}, camera=CAMERA, ground=GROUND)
    assert (again, set(tracker.refused)) == ({}, {1})
    assert set(tracker.update(0.2, {1: good}, camera=CAMERA, ground=GROUND)) == {1}
    assert len(tracker.smooth()[1]) == 2


def test_a_vehicle_that_was_missing_counts_all_motions_since():
    """How the camera moved meanwhile is as unsure as all those motions together."""
    tracker, rng = fgrecon.Tracker(size_prior="kitti"), np.random.default_rng(3)
    for t, pose in enumerate(approaching(4)):
        given = {3: seen(pose, rng)} if t in (0, 3) else {}
        place = {"world_T_camera": upright(0.3 * t, [0.0, 0.0, 2.0 * t])}
        place["motion_covariance"] = np.diag([1e-4] * 3 + [0.01 * t**2] * 3)
        tracker.update(0.1 * t, given, camera=CAMERA, ground=GROUND, **place)
    steps = [frame.step for frame in tracker._tracks[3].vehicle.past]
    assert steps[0] is None
    alike, turned = np.diag(steps[1].covariance)[:3], np.diag(steps[1].covariance)[3:]
    assert alike == pytest.approx([3e-4] * 3)
    assert turned[1] > 0.14  # what was turned wrongly before has led the camera astray since
    assert turned.sum() == pytest.approx(3 * 0.14 + 2 * 1e-4 * (2.0**2 + 4.0**2))


@pytest.mark.parametrize("far", [5e6, 1e12, 1e200, 1e300])
def test_a_world_may_begin_anywhere_and_a_camera_that_goes_astray_is_no_fault(far):
    rng, tracker = np.random.default_rng(3), fgrecon.Tracker(size_prior="kitti", shared_ground=True)
    for t, pose in enumerate(approaching(4)):
        place = upright(0.0, [far, -far, 0.5 * t if far < 1e7 else far * t])
        motion = {"world_T_camera": place, "motion_covariance": 1e-6 * np.eye(6)}
        found = tracker.update(0.1 * t, {3: seen(pose, rng)}, camera=CAMERA, ground=GROUND, **motion)
        assert off(found[3], pose)[0] < 20.0
    assert len(tracker.smooth()[3]) == 4


def test_the_ground_of_a_frame_may_be_shared():
    rng = np.random.default_rng(8)
    places = [(-4.0, 18.0), (2.0, 25.0), (6.0, 40.0)]
    poses = [upright(1.3, [x, GROUND + 0.03 * z, z]) for x, z in places]  # a road that goes down
    given = {i: seen(pose, rng) for i, pose in enumerate(poses)}
    errors = []
    for shared in (False, True):
        tracker = fgrecon.Tracker(size_prior="kitti", shared_ground=shared)
        found = tracker.update(0.0, given, camera=CAMERA, ground=GROUND)
        errors.append(np.mean([off(found[i], pose)[1] for i, pose in enumerate(poses)]))
    assert errors[1] < errors[0]


def test_what_cannot_be_used_is_refused():
    tracker = fgrecon.Tracker()
    tracker.update(1.0, {}, camera=CAMERA)
    with pytest.raises(InvalidInputError, match="time"):
        tracker.update(1.0, {}, camera=CAMERA)
    with pytest.raises(InvalidInputError, match="of nanoseconds a billionth"):
        tracker.update(1.7e18, {}, camera=CAMERA)
    with pytest.raises(InvalidInputError, match="world_T_camera"):
        tracker.update(2.0, {}, camera=CAMERA, world_T_camera=2.0 * np.eye(4))
    with pytest.raises(InvalidInputError, match="motion_covariance"):
        tracker.update(2.0, {}, camera=CAMERA, motion_covariance=-np.eye(6))
    for window in (1, 101):
        with pytest.raises(InvalidInputError, match="window"):
            fgrecon.Tracker(window=window)
    with pytest.raises(InvalidInputError, match="window"):
        fgrecon.Tracker(window=2.5)
    with pytest.raises(InvalidInputError, match="past"):
        fgrecon.Tracker(past=0)
    with pytest.raises(InvalidInputError, match="joint"):
        fgrecon.Tracker(options=fgrecon.Options(shape=fgrecon.ShapeOptions(joint=False)))


def parked(t):
    """Place of a camera at 15 m/s after t tenths of a second, and a parked car's pose before it."""
    place = upright(0.0, [0.0, 0.0, 1.5 * t])
    return place, np.linalg.inv(place) @ upright(-np.pi / 2, [4.0, GROUND, 40.0])


@pytest.mark.parametrize("unknown", [{9}, set(range(9))])
def test_a_velocity_over_the_world_says_nothing_of_one_relative_to_the_camera(unknown):
    """Where the camera's place is not known now and then, a parked car stands in the world all the same."""
    rng, frames, poses = np.random.default_rng(0), [], []
    for t in range(18):
        place, pose = parked(t)
        frames.append((0.1 * t, seen(pose, rng), None if t in unknown else place))
        poses.append(pose)
    online, smoothed = follow(frames)
    for estimates in (online, smoothed):
        for one in estimates[2:]:
            if one.velocity is not None and one.world_T_object is not None:
                assert one.speed < 1.0
            elif one.velocity is not None:
                assert one.velocity[2] < -6.0
    assert online[10 if 9 in unknown else 9].velocity is None  # it has come there in an unknown way
    known = [one.world_T_object[:3, 3] for t, one in enumerate(smoothed) if t >= 10]
    assert np.ptp(known, axis=0).max() < 0.3


def test_a_frame_that_was_flipped_wrongly_is_turned_back():
    """While two turned frames are believed the next ones are taken for turned; later ones say that they were not."""
    rng, poses = np.random.default_rng(2), approaching(12)
    given = [seen(pose, rng, turned=t < 2) for t, pose in enumerate(poses)]
    _, smoothed = follow([(0.1 * t, one, None) for t, one in enumerate(given)])
    assert min(one.reconstruction.diagnostics.weights.mean() for one in smoothed[2:]) > 0.5


def test_a_camera_that_was_lost_for_long_is_known_again_afterwards():
    rng, tracker, sure = np.random.default_rng(0), fgrecon.Tracker(size_prior="kitti"), 1e-6 * np.eye(6)
    lost = 60.0**2 * np.diag([0.25] * 3 + [400.0] * 3)
    for time, way, covariance in ((0.0, 0.0, sure), (50.0, 750.0, sure), (100.0, 1500.0, sure), (160.0, 1510.0, lost)):
        place = upright(0.0, [0.0, 0.0, way])
        tracker.update(time, {}, camera=CAMERA, world_T_camera=place, motion_covariance=covariance)
    for t in range(12):
        _, pose = parked(t)
        place = upright(0.0, [0.0, 0.0, 1511.0 + 1.5 * t])
        found = tracker.update(
            161.0 + 0.1 * t,
            {3: seen(pose, rng)},
            camera=CAMERA,
            ground=GROUND,
            world_T_camera=place,
            motion_covariance=sure,
        )
    assert found[3].speed < 1.0


def test_a_frame_that_is_refused_is_no_part_of_the_way():
    """The camera's motion up to it is counted with the next one, once."""
    rng, empty = np.random.default_rng(0), fgrecon.Observation(np.full((14, 2), np.nan), np.zeros(14))
    few = np.full((14, 2), np.nan)
    few[:2] = [[500.0, 200.0], [560.0, 210.0]]
    tracker = fgrecon.Tracker(size_prior="kitti")
    for t, given in enumerate([None, None, fgrecon.Observation(few, np.ones(14)), empty, None]):
        place, pose = parked(t)
        observation = seen(pose, rng) if given is None else given
        tracker.update(0.1 * t, {3: observation}, camera=CAMERA, ground=GROUND, world_T_camera=place)
    vehicle = tracker._tracks[3].vehicle
    assert vehicle.count == 3
    np.testing.assert_allclose(vehicle.path.camera.translation(), [0.0, 0.0, 6.0], atol=1e-9)


@pytest.mark.parametrize("step", [5e-324, 1e-17, 1e-9])
def test_frames_that_are_hardly_apart_are_refused_and_leave_all_as_it_was(step):
    rng, (first, second, third) = np.random.default_rng(0), approaching(3)
    tracker = fgrecon.Tracker(size_prior="kitti")
    tracker.update(0.0, {3: seen(first, rng)}, camera=CAMERA, ground=GROUND)
    with pytest.raises(InvalidInputError, match="time"):
        tracker.update(step, {3: seen(second, rng)}, camera=CAMERA, ground=GROUND)
    with pytest.raises(InvalidInputError, match="observations"):
        tracker.update(0.1, [seen(second, rng)], camera=CAMERA, ground=GROUND)
    tracker.update(0.1, {3: seen(second, rng)}, camera=CAMERA, ground=GROUND)
    tracker.update(0.2, {3: seen(third, rng)}, camera=CAMERA, ground=GROUND)
    assert len(tracker.smooth()[3]) == 3


def test_calls_of_several_threads_are_taken_one_after_the_other():
    tracker, pose = fgrecon.Tracker(size_prior="kitti"), approaching(1)[0]
    given = [seen(pose, np.random.default_rng(seed)) for seed in range(12)]

    def one(time):
        return tracker.update(time, {3: given[int(10 * time)]}, camera=CAMERA, ground=GROUND)

    with ThreadPoolExecutor(6) as pool:
        errors = [future.exception() for future in [pool.submit(one, 0.1 * t) for t in range(12)]]
    late = [error for error in errors if error is not None]  # a later frame came first
    assert all(isinstance(error, InvalidInputError) and error.field == "time" for error in late)
    assert len(tracker.smooth()[3]) == 12 - len(late) >= 1


def test_it_is_not_copied_and_says_so():
    tracker = fgrecon.Tracker(size_prior="kitti")
    tracker.update(0.0, {3: seen(approaching(1)[0], np.random.default_rng(0))}, camera=CAMERA, ground=GROUND)
    for copied in (pickle.dumps, copy.copy, copy.deepcopy):
        with pytest.raises(TypeError, match="cannot be copied or pickled"):
            copied(tracker)
    problem = tracker._tracks[3].vehicle.past[0].problem
    assert problem.energy.compiled is not None or native("factors._energy") is None
    again = pickle.loads(pickle.dumps(problem.energy))
    assert (again.compiled is None) == (problem.energy.compiled is None)
