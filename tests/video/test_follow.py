"""Following vehicles: ids, the camera's place in the world, and what the association is given."""

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from fgrecon.core.camera import Ground
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.evidence import Points
from fgrecon.core.observation import Observation
from fgrecon.core.reconstruction import Status
from fgrecon.io.export import read_video_frames
from fgrecon.io.poses import CameraPoses
from fgrecon.simulation import KITTI_CAMERA
from fgrecon.solve.tracker import Tracker
from fgrecon.video import Follower, GatedAssociation, SingleImageTracker, VideoRun
from fgrecon.video.camera_path import CameraPath
from fgrecon.video.egomotion import CameraMotion
from fgrecon.video.frame_store import FrameStore
from fgrecon.video.records import FrameRecord, Sighting
from fgrecon.video.rows import frame_lines, rows_of, tracking_text
from fgrecon.video.video_job import _keypoint_warnings
from tests.video.streets import simulated


def follower(**arguments):
    return Follower(SingleImageTracker(prior="car14"), GatedAssociation(first=50), KITTI_CAMERA, **arguments)


def record(number, *sightings, **arguments):
    return FrameRecord(number, 0.1 * number, f"{number}.png", arguments.pop("problem", None), sightings, **arguments)


def step(length):
    motion = np.eye(4)
    motion[2, 3] = length
    return CameraMotion(motion, np.eye(6) * 1e-4, 100)


def test_given_ids_stay_and_others_are_new():
    first, second = simulated(2, seeds=(25, 7))
    follow = follower(ground=Ground.level(1.65))
    frames = [
        follow(record(n, Sighting(first[n].box, 1.0, 3, first[n]), Sighting(second[n].box, 1.0, None, second[n])))
        for n in range(2)
    ]
    assert [sorted(frame.boxes) for frame in frames] == [[3, 50]] * 2
    assert [sorted(frame.estimates) for frame in frames] == [[3, 50]] * 2
    assert frames[1].observations[3] is first[1]
    assert frames[0].world_T_camera is None


def test_a_frame_has_the_window_that_is_asked_for():
    """That of the nearest vehicle among those of the longest windows."""
    first, second = simulated(2, seeds=(25, 7))
    asked = []
    follow = follower(ground=Ground.level(1.65), window_graph=lambda identity: (asked.append(identity), (identity,))[1])
    followed = follow(record(0, Sighting(first[0].box, 1.0, 3, first[0]), Sighting(second[0].box, 1.0, 4, second[0])))
    distance = {i: np.linalg.norm(e.reconstruction.location) for i, e in followed.estimates.items()}
    nearest = min(distance, key=distance.get)
    assert asked == [nearest]
    assert followed.window == (nearest,)
    assert follow(record(1)).window == ()
    assert follower()(record(0, Sighting(first[0].box, 1.0, 3, first[0]))).window == ()


def test_a_vehicle_without_keypoints_has_a_box_alone():
    (first,) = simulated(1, seeds=(25,))
    frame = follower()(record(0, Sighting(first[0].box, 1.0, None, None)))
    assert (sorted(frame.boxes), frame.estimates) == ([50], {})


def test_weak_detections_have_no_id():
    (first,) = simulated(1, seeds=(25,))
    assert follower()(record(0, Sighting(first[0].box, 0.2, None, first[0]))).boxes == {}


def test_the_world_is_made_of_motions():
    """One that is missing goes on as before; a frame that cannot be read has no place, and the next covers it."""
    follow = follower(path=CameraPath(moving=True))
    records = [
        record(0),
        record(1, motion=step(1.0)),
        record(2),
        record(3, problem="torn"),
        record(4, motion=step(2.0)),
    ]
    places = [follow(r).world_T_camera for r in records]
    assert [None if p is None else round(float(p[2, 3]), 6) for p in places] == [0.0, 1.0, 2.0, None, 4.0]


def test_the_motion_up_to_a_frame_that_is_left_out_is_no_less_a_part_of_the_way():
    """The next motion begins at its image; where it is not known, nothing is known of the way since."""
    follow = follower(path=CameraPath(moving=True))
    covariances = []
    follow.tracker.update = lambda *_, motion_covariance, **__: covariances.append(motion_covariance) or {}
    places = []
    for number, time, motion in ((0, 0.0, None), (1, 0.1, step(1.0)), (2, 0.1, step(1.0)), (3, 0.2, step(1.0))):
        places.append(follow(FrameRecord(number, time, f"{number}.png", None, (), motion)).world_T_camera)
    assert [None if p is None else p[2, 3] for p in places] == [0.0, 1.0, None, 3.0]
    assert np.diag(covariances[-1])[[0, 5]] == pytest.approx([2e-4, 2e-4])
    follow(FrameRecord(4, 0.2, "4.png", None, (), None))
    follow(FrameRecord(5, 0.3, "5.png", None, (), step(1.0)))
    assert np.sqrt(covariances[-1][5, 5]) > 1.0


def test_a_camera_whose_motion_is_lost_has_no_place():
    """It goes on for a second; later motions know that nothing is known of those between."""
    follow = follower(path=CameraPath(moving=True))
    assert [follow(record(n)).world_T_camera is None for n in range(4)] == [False, True, True, True]
    covariances = []
    follow.tracker.update = lambda *_, motion_covariance, **__: covariances.append(motion_covariance) or {}
    motions = {4: step(1.0), 20: step(1.0), 21: step(1.0)}
    placed = [n for n in range(4, 23) if follow(record(n, motion=motions.get(n))).world_T_camera is not None]
    assert placed == [*range(4, 15), 20, 21, 22]
    by_number = dict(zip(range(4, 23), covariances, strict=True))
    assert by_number[17] is None
    sigmas = {n: np.sqrt(np.diag(by_number[n])[[0, 5]]) for n in (4, 5, 20, 21)}
    assert sigmas[4][1] == pytest.approx(np.hypot(0.01, 0.3 * 20.0))
    assert sigmas[5] == pytest.approx((0.02, 0.5))
    assert sigmas[20][1] == pytest.approx(np.hypot(0.01, 0.5 * 20.0))
    assert sigmas[21] == pytest.approx((0.01, 0.01))


def test_the_world_is_given():
    poses = CameraPoses({n: step(float(n)).previous_T_current for n in (0, 2)})
    follow = follower(path=CameraPath(poses))
    places = [follow(record(n)).world_T_camera for n in range(3)]
    assert places[1] is None
    assert places[2][2, 3] == 2.0


def test_an_estimate_is_in_the_world():
    (first,) = simulated(1, seeds=(25,))
    poses = CameraPoses({0: step(5.0).previous_T_current})
    frame = follower(path=CameraPath(poses), ground=Ground.level(1.65))(
        record(0, Sighting(first[0].box, 1.0, 1, first[0]))
    )
    estimate = frame.estimates[1]
    assert estimate.world_T_object[2, 3] == pytest.approx(estimate.reconstruction.location[2] + 5.0)


def test_speeds_are_of_the_world_or_there_are_none():
    (first,) = simulated(8, seeds=(25,))
    for poses, moving in (
        (CameraPoses({n: step(0.5 * n).previous_T_current for n in range(4)}), [False, *[True] * 3, *[False] * 4]),
        (None, [False, *[True] * 7]),
    ):
        follow = Follower(
            Tracker(), GatedAssociation(), KITTI_CAMERA, path=CameraPath(poses), ground=Ground.level(1.65)
        )
        frames = [follow(record(n, Sighting(one.box, 1.0, 1, one))) for n, one in enumerate(first)]
        assert [frame.estimates[1].velocity is not None for frame in frames] == moving
        run = VideoRun(8, frames=FrameStore(frames))
        run.smooth(follow)
        for frame in run.frames:  # that between frames with and without a pose knows of neither kind
            known = poses is None or frame.number < 3
            assert (frame.estimates[1].speed is not None) == known
            assert (frame.estimates[1].turn_rate is not None) == known


def test_time_goes_forward():
    """A frame that is not later than the one before is a gap, whatever it shows."""
    (first,) = simulated(2, seeds=(25,))
    follow = follower()
    sighting = Sighting(first[0].box, 1.0, 1, first[0])
    assert follow(record(5, sighting)).problem is None
    again = follow(FrameRecord(6, 0.5, "6.png", None, (sighting,)))
    assert "not later" in again.problem
    assert (again.boxes, again.estimates) == ({}, {})
    assert follow(record(7, sighting)).estimates.keys() == {1}


def test_single_images_tell_their_facing_and_why_they_refuse():
    (first,) = simulated(1, seeds=(25,))
    towards = np.zeros(8)
    towards[0] = 1.0
    few = replace(first[0], keypoints=np.where(np.arange(14)[:, None] < 1, first[0].keypoints, np.nan), box=None)
    tracker = SingleImageTracker(prior="car14")
    found = tracker.update(0.0, {1: replace(first[0], azimuth=towards), 2: first[0], 3: few}, camera=KITTI_CAMERA)
    for estimate in found.values():
        assert 0.0 < estimate.facing_probability < 1.0
        assert estimate.facing_probability == estimate.reconstruction.facing_probability
    assert found[1].facing_probability != found[2].facing_probability  # directions and energies
    assert tracker.refused.keys() == {3}
    assert tracker.smooth()[1] == [found[1]]


def test_a_tracker_is_given_how_sure_a_motion_is():
    covariances = []

    class Listening(SingleImageTracker):
        def update(self, time, observations, *, motion_covariance=None, **arguments):
            covariances.append(motion_covariance)
            return super().update(time, observations, **arguments)

    follow = Follower(Listening(prior="car14"), GatedAssociation(), KITTI_CAMERA, path=CameraPath(moving=True))
    for one in (record(0), record(1, motion=step(1.0)), record(2)):
        follow(one)
    assert covariances[0] is None
    assert covariances[1] == pytest.approx(1e-4 * np.eye(6))
    assert covariances[2][5, 5] > 0.1**2


def test_a_vehicle_is_of_the_kind_that_most_of_its_frames_gave():
    """In KITTI's lines, tables and JSON alike; one of which nothing is said is a car."""
    van, car = simulated(3, seeds=(25, 7))
    follow = follower()
    kinds = ["Truck", "Van", "Van"]
    frames = [
        follow(record(n, Sighting(van[n].box, 1.0, 3, van[n], kind), Sighting(car[n].box, 1.0, 4, car[n])))
        for n, kind in enumerate(kinds)
    ]
    assert [frame.kinds for frame in frames] == [{3: "Truck", 4: "Car"}, {3: "Truck", 4: "Car"}, {3: "Van", 4: "Car"}]
    last = frames[-1:]
    assert [line.split()[2] for line in tracking_text(last).splitlines()] == ["Van", "Car"]
    assert [row["kind"] for row in rows_of(last)] == ["Van", "Car"]
    (line,) = frame_lines(last)
    assert [vehicle["kind"] for vehicle in json.loads(line)["vehicles"]] == ["Van", "Car"]


def test_lines_of_frames_tell_the_ground_to_exports(tmp_path):
    (seen, *_) = simulated(1, seeds=(7,))[0]
    frame = follower()(record(0, Sighting(seen.box, 1.0, 3, seen)))
    for given in (Ground(np.array([0.0, 1.0, 0.1]), 1.5), None):
        (file := tmp_path / "frames.jsonl").write_text("".join(frame_lines([frame], given)))
        ((vehicle,), _) = read_video_frames(file)
        if given is None:
            assert vehicle.ground is None
        else:
            np.testing.assert_allclose(
                [*vehicle.ground.normal, vehicle.ground.distance], [*given.normal, given.distance]
            )


def test_a_tracker_is_given_what_other_sensors_say_of_the_frame():
    given = []

    class Listening(SingleImageTracker):
        def update(self, time, observations, *, evidence=(), **arguments):
            given.append(evidence)
            return super().update(time, observations, evidence=evidence, **arguments)

    points = Points(np.array([[0.0, 0.0, 10.0]]))
    known = {1: (points,)}
    sense = lambda one: known.get(one.number, ())  # noqa: E731 - shorter than a function
    follow = Follower(Listening(prior="car14"), GatedAssociation(), KITTI_CAMERA, sense=sense)
    for one in (record(0), record(1)):
        follow(one)
    assert given == [(), (points,)]


def test_evidence_that_cannot_be_used_names_its_frame():
    beside = Points(np.array([[0.0, 0.0, -10.0]]))
    follow = Follower(Tracker(prior="car14"), GatedAssociation(), KITTI_CAMERA, sense=lambda _: (beside,))
    with pytest.raises(InvalidInputError, match=r"^7\.png: evidence\[0\]"):
        follow(record(7))


@pytest.mark.parametrize("share", [0.2, 0.9])
def test_a_scan_in_a_wrong_place_is_named_by_all_frames(share):
    """Of two vehicles, whose estimates know how many of the points before them are theirs."""
    known = SimpleNamespace(
        own_shares={"points": share}, mirrored_gain=np.nan, weights=np.ones(14), energies={"ground": 0.0}
    )
    known.left_out = ()
    result = SimpleNamespace(diagnostics=known, reasons=(), status=Status.FAILED)
    seen = dict.fromkeys((3, 4), Observation.of(np.zeros((14, 2)), np.ones(14)))
    estimates = dict.fromkeys(seen, SimpleNamespace(reconstruction=result))
    run = SimpleNamespace(frames=[SimpleNamespace(name="7", observations=seen, estimates=estimates)] * 3)
    job = SimpleNamespace(given=None, sense=len, camera=KITTI_CAMERA, request=SimpleNamespace(source="drive"))
    lines = _keypoint_warnings(job, run)
    assert [line for line in lines if "scan is not where" in line] == lines[:1] * (share < 0.5)
    job.sense = None  # nobody gave any
    assert not _keypoint_warnings(job, run)
