"""Rigs: cameras of different intrinsics and mounts whose frames are of the same times."""

import numpy as np
import pytest

import fgrecon
from fgrecon.core.camera import Camera
from fgrecon.core.errors import InvalidInputError
from fgrecon.solve.time.frame import FrameStep
from tests.solve.time.streets import PRIOR, seen, upright

FRONT = Camera(np.array([[721.5, 0.0, 609.6], [0.0, 721.5, 172.9], [0.0, 0.0, 1.0]]), image_size=(1242, 375))
SIDE = Camera(np.array([[520.0, 0.0, 480.0], [0.0, 515.0, 300.0], [0.0, 0.0, 1.0]]), image_size=(960, 600))
RIG = {
    "front": (FRONT, np.eye(4), 1.65),
    "side": (SIDE, upright(np.radians(-55.0), [-0.6, -0.1, -0.4]), 1.75),  # to the left
}
"""Camera, its pose in the rig, and its height."""
OWN_FLEET = fgrecon.Options(shape=fgrecon.ShapeOptions(own_fleet=True))


def on_road(x, z, ahead=True):
    """A car's pose on a road 1.65 m below the front camera's."""
    return upright(-np.pi / 2.0 if ahead else np.pi / 2.0, [x, 1.65, z])


def shown(pose, camera, rng, **given):
    """What a camera shows of a car (4, 4): its observation, or None where it is not all in the image."""
    points = PRIOR.mean @ pose[:3, :3].T + pose[:3, 3]
    if points[:, 2].min() < 1.0:
        return None
    pixels = camera.project(points)
    inside = (pixels >= 0.0) & (pixels < camera.image_size)
    return seen(pose, rng, camera=camera, **given) if inside.all() else None


def drive(tracker, times, rig_speed, cars, rng, rig=RIG):
    """Take the frames of a rig that drives ahead (`cars`: poses by id at a time). Camera, truth, estimate of each."""
    found = []
    for time in times:
        truth = cars(time)
        for name, (camera, mount, height) in rig.items():
            place = upright(0.0, [0.0, 0.0, rig_speed * time]) @ mount
            all_seen = {i: shown(np.linalg.inv(place) @ car, camera, rng) for i, car in truth.items()}
            given = {i: one for i, one in all_seen.items() if one is not None}
            estimates = tracker.update(time, given, camera=camera, world_T_camera=place, ground=height)
            assert not tracker.refused
            found += [(name, truth[i], estimate) for i, estimate in estimates.items()]
    return found


def place_error(estimate, truth):
    return float(np.linalg.norm(estimate.world_T_object[:3, 3] - truth[:3, 3]))


@pytest.mark.parametrize(
    ("speed", "start", "rig_speed"),
    [(0.0, 20.0, 8.0), (0.0, 12.0, 4.0), (10.0, 3.0, 4.0), (-6.0, 10.0, 2.0)],
    ids=["parked", "parked, first in both", "overtaking", "oncoming, first in both"],
)
def test_cars_are_handed_from_one_camera_to_the_other(speed, start, rig_speed):
    tracker, times = fgrecon.Tracker(options=OWN_FLEET), [0.1 * t for t in range(24)]

    def car(time):
        return {3: on_road(-5.0, start + speed * time, ahead=speed >= 0.0)}

    found = drive(tracker, times, rig_speed, car, np.random.default_rng(1))
    online, smoothed = [estimate for *_, estimate in found], tracker.smooth()[3]
    assert {name for name, *_ in found} == {"front", "side"}
    assert len({one.time for one in online}) < len(online)  # both see it for a while
    assert [one.time for one in smoothed] == [one.time for one in online]
    begun = online[0].time
    assert all(one.velocity is None for one in online if one.time == begun)  # no time has passed
    for estimates, settled in ((online, 0.5), (smoothed, 0.0)):
        errors = [place_error(one, truth) for (_, truth, _), one in zip(found, estimates, strict=True)]
        assert np.mean(errors) < 0.8
        assert max(errors) < 1.3
        for one in estimates:
            if one.time >= begun + settled:
                np.testing.assert_allclose(one.velocity, [0.0, 0.0, speed], atol=0.8)


def at_one_time(names, rng, turned=()):
    """The last facing probability of a far car that cameras see at one time."""
    tracker, car = fgrecon.Tracker(options=OWN_FLEET), on_road(-14.0, 22.0)
    for name in names:
        camera, mount, height = RIG[name]
        given = {3: shown(np.linalg.inv(mount) @ car, camera, rng, turned=name in turned)}
        found = tracker.update(5.0, given, camera=camera, world_T_camera=mount, ground=height)[3]
    return found.facing_probability


def test_what_cameras_say_at_one_time_of_the_facing_counts_of_each_and_in_any_order():
    both, other_way = (at_one_time(names, np.random.default_rng(4)) for names in (("front", "side"), ("side", "front")))
    alone = [at_one_time([name], np.random.default_rng(4)) for name in RIG]
    assert 1.0 - both < 0.5 * (1.0 - max(alone))
    assert both == pytest.approx(other_way, abs=0.02)
    assert at_one_time(("front", "side"), np.random.default_rng(4), turned=["front"]) < 0.9


def test_neighbours_are_those_of_one_camera():
    """What looks like one row in the images of two cameras is none."""
    rng, times = np.random.default_rng(5), [0.1 * t for t in range(4)]
    cars = {1: on_road(2.0, 18.0), 2: RIG["side"][1] @ upright(-np.pi / 2.0, [2.0, 1.75, 11.0])}
    given, together = [], fgrecon.Tracker(options=OWN_FLEET)
    for time in times:
        for i, (camera, mount, height) in zip(cars, RIG.values(), strict=True):
            seen_by = {"camera": camera, "world_T_camera": mount, "ground": height}
            given.append((time, {i: shown(np.linalg.inv(mount) @ cars[i], camera, rng)}, seen_by))
            together.update(time, given[-1][1], **seen_by)
    for i in cars:
        alone = fgrecon.Tracker(options=OWN_FLEET)
        for time, one, seen_by in given:
            if i in one:
                alone.update(time, one, **seen_by)
        for first, second in zip(alone.smooth()[i], together.smooth()[i], strict=True):
            assert first.facing_probability == pytest.approx(second.facing_probability, rel=1e-9)
            np.testing.assert_allclose(first.world_T_object, second.world_T_object, atol=1e-5)


def test_three_cameras_share_a_ground():
    """Also one that nobody tells; the third camera is the first one's twin beside it."""
    rig = RIG | {"twin": (FRONT, upright(0.0, [0.5, 0.0, 0.0]), 1.65)}
    parked = {0: on_road(-5.0, 15.0), 1: on_road(4.0, 19.0, ahead=False), 2: on_road(-9.0, 6.0), 3: on_road(-5.0, 26.0)}
    for shared_rig in (rig, {name: (camera, mount, None) for name, (camera, mount, _) in rig.items()}):
        tracker = fgrecon.Tracker(options=OWN_FLEET, shared_ground=True)
        found = drive(
            tracker, [0.1 * t for t in range(8)], 4.0, lambda _: parked, np.random.default_rng(6), rig=shared_rig
        )
        assert {name for name, *_ in found} == set(rig)
        assert np.mean([place_error(one, truth) for _, truth, one in found[-8:]]) < 0.8
        assert max(one.speed for _, _, one in found[-8:]) < 0.5


def test_how_cameras_of_a_rig_lie_to_each_other_is_no_motion_that_goes_on():
    """Where the next frame has no place, its vehicle is sought where it was in the last one."""
    tracker, car = fgrecon.Tracker(options=OWN_FLEET), on_road(-14.0, 22.0)
    drive(tracker, [0.0, 0.1], 0.0, lambda _: {3: car}, np.random.default_rng(7))
    foreseen = tracker._tracks[3].vehicle.foreseen(FrameStep(0.1, None, np.zeros((6, 6))))
    truth = np.linalg.inv(RIG["side"][1]) @ car
    assert np.linalg.norm(foreseen[:3, 3] - truth[:3, 3]) < 2.0


def test_one_time_is_for_different_cameras_with_places():
    tracker = fgrecon.Tracker()
    tracker.update(1.0, {}, camera=FRONT)
    with pytest.raises(InvalidInputError, match="`world_T_camera`"):
        tracker.update(1.0, {}, camera=SIDE, world_T_camera=RIG["side"][1])  # the first one has none
    tracker.update(2.0, {}, camera=FRONT, world_T_camera=np.eye(4))
    with pytest.raises(InvalidInputError, match="`world_T_camera`"):
        tracker.update(2.0, {}, camera=SIDE)
    for time in (2.0, 2.0 + 1e-9, 2.0 - 1e-9):  # clocks' digits
        with pytest.raises(InvalidInputError, match="Different cameras"):
            tracker.update(time, {}, camera=FRONT, world_T_camera=np.eye(4))  # the same frame again
    tracker.update(2.0, {}, camera=SIDE, world_T_camera=RIG["side"][1])
    tracker.update(2.0, {}, camera=SIDE, world_T_camera=np.eye(4))  # another lens at the same place
    with pytest.raises(InvalidInputError, match="time"):
        tracker.update(1.9, {}, camera=FRONT, world_T_camera=np.eye(4))
