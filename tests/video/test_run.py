"""Runs over videos: stopped and gone on with, they give what one that was not stopped gives."""

import sys
import threading
import time
from dataclasses import fields, replace

import numpy as np
import pytest

from fgrecon.core.camera import Ground
from fgrecon.core.errors import DamagedFileWarning, InvalidInputError, UncoveredFramesWarning
from fgrecon.core.options import Options
from fgrecon.io.catalogue import load_category, load_prior
from fgrecon.io.frames import ImageFrames
from fgrecon.io.kitti_files import read_drive
from fgrecon.io.run_settings import RunSettings
from fgrecon.io.video_frames import write_video
from fgrecon.simulation import KITTI_CAMERA
from fgrecon.video import (
    CameraPoses,
    Follower,
    FrameDetector,
    GatedAssociation,
    MotionEstimator,
    SingleImageTracker,
    VideoRun,
    open_frames,
    read_given,
    rows_of,
    run_video,
)
from fgrecon.video.camera_path import CameraPath
from fgrecon.video.coverage import coverage_warnings, planned_frames
from fgrecon.video.newest import LEFT_OUT, LiveFrames
from fgrecon.video.video_job import VideoRequest, prepare_video, track_video
from tests.video.streets import make_drive

CAR14 = load_category("car14")
GROUND = Ground.level(1.65)


class Counting(FrameDetector):
    """Counts how many frames it looks at."""

    looked = 0

    def record(self, frame, vehicles):
        self.looked += 1
        return super().record(frame, vehicles)


@pytest.fixture(scope="module")
def drive(tmp_path_factory):
    images, file = make_drive(tmp_path_factory.mktemp("drive"), metres=0.4)
    (images / "000009.png").write_bytes(b"torn")
    return images, file


def run(drive, out, *, most=None, moving=False, ground=GROUND, **arguments):
    images, file = drive
    look = Counting(CAR14, given=read_given(file, CAR14).vehicles)
    follower = Follower(
        SingleImageTracker(prior="car14"),
        GatedAssociation(),
        KITTI_CAMERA,
        ground=ground,
        path=CameraPath(moving=moving),
    )
    found = run_video(
        open_frames(images, rate=10),
        look,
        follower,
        out,
        settings={"of": "a test"},
        motion=MotionEstimator(KITTI_CAMERA, ground) if moving else None,
        go_on=lambda run, _: most is None or len(run.frames) < most,
        **arguments,
    )
    return found, look


def test_a_run_has_every_frame(drive, tmp_path):
    found, look = run(drive, tmp_path / "out")
    assert [frame.number for frame in found.frames] == [3, 4, 5, 6, 8, 9, 10, 11]
    assert [frame.time for frame in found.frames][-1] == pytest.approx(1.1)
    assert found.total == look.looked == 8
    assert list(found.gaps) == ["000009.png"]
    assert found.tracks == {10: 8, 11: 8}
    assert found.estimates == len(rows_of(found.frames)) > 12
    assert (found.stopped, found.smoothed, found.before) == (False, True, 0)


@pytest.mark.parametrize("ahead", [0, 1, 2])
@pytest.mark.parametrize("moving", [False, True])
@pytest.mark.parametrize("most", [1, 3, 6])
def test_a_stopped_run_goes_on(drive, tmp_path, monkeypatch, most, moving, ahead):
    monkeypatch.setattr("fgrecon.video.run.AHEAD", 0)
    whole, _ = run(drive, tmp_path / "whole", moving=moving)
    monkeypatch.setattr("fgrecon.video.run.AHEAD", ahead)
    assert whole.way == (pytest.approx(0.4 * 8, abs=0.1) if moving else None)
    part, look = run(drive, tmp_path / "out", most=most, moving=moving)
    assert (part.stopped, len(part.frames)) == (True, most)
    assert most <= look.looked <= most + 2 * (ahead + 1) * bool(ahead)
    assert not [thread.name for thread in threading.enumerate() if thread.name.startswith("fgrecon")]
    rest, look = run(drive, tmp_path / "out", moving=moving)
    assert (rest.stopped, rest.before, look.looked) == (False, most, 8 - most)
    assert rows_of(rest.frames) == rows_of(whole.frames)
    again, look = run(drive, tmp_path / "out", moving=moving, online=True)
    assert (again.before, look.looked, again.smoothed) == (8, 0, False)


@pytest.mark.parametrize("folder", ["records", "motions"])
@pytest.mark.parametrize("damaged", [1, 3])
def test_damaged_records_are_made_again(drive, tmp_path, monkeypatch, damaged, folder):
    monkeypatch.setattr("fgrecon.batch.parts._ROWS", 2)
    whole, _ = run(drive, tmp_path / "out", moving=True)
    parts = sorted((tmp_path / "out" / folder).glob("part-*.parquet"))
    assert len(parts) == 4
    parts[damaged].write_bytes(parts[damaged].read_bytes()[:-50])
    with pytest.warns(DamagedFileWarning, match=parts[damaged].name):
        again, look = run(drive, tmp_path / "out", moving=True)
    before = 2 * damaged if folder == "records" else 8
    assert (again.before, look.looked) == (before, 8 - before)
    assert rows_of(again.frames) == rows_of(whole.frames)
    assert run(drive, tmp_path / "out", moving=True)[0].before == 8


@pytest.mark.parametrize("stage", ["boxes", "keypoints", "motion", "follow"])
def test_an_error_of_a_stage_is_that_of_the_run(drive, tmp_path, stage):
    """It comes at its frame, what was looked at before is stored, and no thread is left."""

    class Failing(Counting):
        def vehicles(self, frame):
            if stage == "boxes" and frame.number == 8:
                raise ZeroDivisionError(stage)
            return super().vehicles(frame)

        def record(self, frame, vehicles):
            if stage == "keypoints" and frame.number == 8:
                raise ZeroDivisionError(stage)
            return super().record(frame, vehicles)

    class Lost(MotionEstimator):
        def __call__(self, frame, sightings):
            if stage == "motion" and frame.number == 8:
                raise ZeroDivisionError(stage)
            return super().__call__(frame, sightings)

    def go_on(run, _):
        if stage == "follow" and len(run.frames) == 4:
            raise ZeroDivisionError(stage)
        return True

    look = Failing(CAR14, given=read_given(drive[1], CAR14).vehicles)
    follower = Follower(
        SingleImageTracker(prior="car14"), GatedAssociation(), KITTI_CAMERA, ground=GROUND, path=CameraPath(moving=True)
    )
    source, motion = open_frames(drive[0], rate=10), Lost(KITTI_CAMERA, GROUND)
    turn = sys.getswitchinterval()
    with pytest.raises(ZeroDivisionError, match=stage):
        run_video(source, look, follower, tmp_path, settings={"of": "a test"}, motion=motion, go_on=go_on)
    assert sys.getswitchinterval() == turn
    assert not [thread.name for thread in threading.enumerate() if thread.name.startswith("fgrecon")]
    assert run(drive, tmp_path, moving=True)[0].before == 4


def test_another_ground_needs_no_network(drive, tmp_path):
    """Motions are estimated again on another ground, and one without motions leaves them alone."""
    higher = Ground.level(1.9)
    run(drive, tmp_path / "out", moving=True, most=5)
    again, look = run(drive, tmp_path / "out", moving=True, ground=higher)
    assert (again.before, look.looked) == (5, 3)
    fresh, _ = run(drive, tmp_path / "fresh", moving=True, ground=higher)
    assert rows_of(again.frames) == rows_of(fresh.frames)
    assert run(drive, tmp_path / "out")[1].looked == 0
    assert run(drive, tmp_path / "out", moving=True, ground=higher)[1].looked == 0


def test_smoothed_estimates_are_the_same_whether_others_were_made_before(drive, tmp_path):
    images, file = drive
    settings = RunSettings(load_prior("car14"), GROUND, None, Options(keep_history=False))
    request = VideoRequest(str(images), tmp_path / "now", settings, fps=10, tracks=file, forget_ids=True)
    job, found = prepare_video(request, print), {}
    for estimated in (True, False):
        between = []
        there = replace(job, request=replace(request, out=tmp_path / str(estimated)))
        done = track_video(
            there,
            print,
            go_on=lambda run, _, between=between: not between.append(len(run.frames[-1].estimates)),
            estimated=estimated,
        )
        assert bool(sum(between)) is estimated
        found[estimated] = rows_of(done.frames)
    assert found[True] == found[False]
    assert len(found[True]) > 10


def test_a_folder_is_for_one_run(drive, tmp_path):
    run(drive, tmp_path / "out", most=1)
    follower = Follower(SingleImageTracker(prior="car14"), GatedAssociation(), KITTI_CAMERA)
    with pytest.raises(InvalidInputError, match="other settings"):
        run_video(open_frames(drive[0]), FrameDetector(CAR14), follower, tmp_path / "out", settings={"of": "another"})


def follow_with_poses(drive, out, poses, *, given=None, most=99):
    """A run with such poses of the camera, and vehicles for such frames instead of the file's."""
    vehicles = read_given(drive[1], CAR14).vehicles
    given = vehicles if given is None else dict.fromkeys(given, next(iter(vehicles.values())))
    follower = Follower(SingleImageTracker(prior="car14"), GatedAssociation(), KITTI_CAMERA, path=CameraPath(poses))
    look, source = FrameDetector(CAR14, given=given), open_frames(drive[0], rate=10)
    go_on = {"go_on": lambda run, _: len(run.frames) < most}
    return run_video(source, look, follower, out, settings={"of": sorted(given)}, **go_on)


def test_poses_of_no_frame_are_refused(drive, tmp_path):
    """Frames 3 to 11, at 0.3 to 1.1 s."""
    stamped = CameraPoses({}, (1.7e9, 1.7e9 + 0.5), (np.eye(4), np.eye(4)))
    numbered = CameraPoses({100: np.eye(4), 104: np.eye(4)})
    for poses, theirs, ours in (
        (stamped, "1700000000 to 1700000000 s", "0.3 to 1.1 s"),
        (numbered, "100 to 104", "3 to 11"),
    ):
        with pytest.raises(InvalidInputError, match="poses") as caught:
            follow_with_poses(drive, tmp_path / "out", poses)
        assert (theirs in str(caught.value), ours in str(caught.value)) == (True, True), caught.value
        assert not (tmp_path / "out").exists()


def test_frames_without_a_pose_are_counted(drive, tmp_path):
    poses = CameraPoses({number: np.eye(4) for number in range(4, 13)})
    with pytest.warns(
        UncoveredFramesWarning, match=r"1 of 8 frames has no pose .* frames 4 to 12, the frames 3 to 11\. Do"
    ) as seen:
        found = follow_with_poses(drive, tmp_path / "out", poses)
    assert (len(seen), found.warnings) == (1, [str(seen[0].message)])
    assert "count from 4 instead of 3?" in found.warnings[0]
    whole = CameraPoses({number: np.eye(4) for number in range(20)})
    assert not follow_with_poses(drive, tmp_path / "out", whole).warnings
    assert not follow_with_poses(drive, tmp_path / "stopped", poses, most=4).warnings


def test_vehicles_of_frames_that_are_not_there_are_counted(drive, tmp_path):
    with pytest.warns(
        UncoveredFramesWarning, match="for 2 frames that are not there: theirs are 4 to 12, those of the source 3 to 11"
    ):
        follow_with_poses(drive, tmp_path / "out", None, given=(4, 7, 12))  # there is no frame 7
    with pytest.raises(InvalidInputError, match=r"vehicles in frames 12 to 30\. Give vehicles of the frames, 3 to 11"):
        follow_with_poses(drive, tmp_path / "none", None, given=(12, 30))
    chosen = open_frames(drive[0], rate=10, every=2)
    assert (chosen.numbers, chosen.left_out) == ((3, 5, 8, 10), {4, 6, 9, 11})
    moments = planned_frames(chosen)
    assert moments == [(3, 0.3), (5, 0.5), (8, 0.8), (10, 1.0)]
    assert not coverage_warnings(moments, chosen, None, (3, 4, 11))


def test_a_run_that_is_stopped_at_its_last_frame_has_ended(drive, tmp_path):
    """Whatever the head of the file tells of the number of frames."""
    look = FrameDetector(CAR14, given=read_given(drive[1], CAR14).vehicles)

    class Guessing(ImageFrames):
        count = 3

    known = open_frames(drive[0], rate=10)
    source = Guessing(*(getattr(known, field.name) for field in fields(known)))
    for most, stopped in ((3, True), (5, True), (8, False), (2, True)):
        follower = Follower(SingleImageTracker(prior="car14"), GatedAssociation(), KITTI_CAMERA)
        go_on = {"go_on": lambda run, _, most=most: len(run.frames) < most}
        found = run_video(source, look, follower, tmp_path / "out", settings={}, **go_on)
        assert (len(found.frames), found.stopped) == (most, stopped)


def test_a_video_has_the_frames_that_it_has(tmp_path):
    """Its head tells 30 a second, and so half of its frames, which come at 60."""
    pytest.importorskip("av", reason="PyAV is not installed: pip install fgrecon[video]")
    with write_video(tmp_path / "uneven.mkv", rate=30) as add:
        for number in range(40):
            add(np.full((96, 128, 3), 6 * number, np.uint8), number / 60)
    source = open_frames(tmp_path / "uneven.mkv")
    assert source.count < 40
    assert [number for number, _ in planned_frames(source)] == list(range(40))
    assert [time for _, time in planned_frames(source)] == pytest.approx(np.arange(40) / 60, abs=2e-3)
    request = VideoRequest(
        str(source.path), tmp_path / "out", RunSettings(load_prior("car14"), None, None, Options()), picture_frame=39
    )
    calls = {"warn": lambda _: None}
    assert prepare_video(request, **calls).request.picture_frame == 39
    with pytest.raises(InvalidInputError, match="picture_frame"):
        prepare_video(replace(request, picture_frame=40), **calls)
    for most, stopped in ((39, True), (40, False)):
        follower = Follower(SingleImageTracker(prior="car14"), GatedAssociation(), KITTI_CAMERA)
        look = FrameDetector(CAR14, given={0: ()})
        go_on = {"go_on": lambda run, _, most=most: len(run.frames) < most}
        assert run_video(source, look, follower, tmp_path / f"{most}", settings={}, **go_on).stopped == stopped


@pytest.mark.data
@pytest.mark.slow
def test_kittis_frames_from_pixels(data, tmp_path):
    """Detector, networks, association and ego-motion on six frames; stopped after two, it goes on to the same rows."""
    from fgrecon.perception.keypoints.detect import shipped_cascade
    from fgrecon.perception.vehicles import NanodetVehicleDetector

    folder = data / "kitti_video" / "kitti_tracking_0010"
    camera = read_drive(folder).calibration.camera
    detector, cascade = NanodetVehicleDetector(), shipped_cascade()

    def go(out, most):
        look = FrameDetector(CAR14, vehicle_detector=detector, keypoint_detector=cascade)
        tracker = SingleImageTracker(prior="car14", size_prior="kitti")
        follower = Follower(tracker, GatedAssociation(), camera, ground=GROUND, path=CameraPath(moving=True))
        source, motion = open_frames(folder, rate=10, start=8.0, end=8.6), MotionEstimator(camera, GROUND)
        return run_video(
            *(source, look, follower, out), settings={}, motion=motion, go_on=lambda run, _: len(run.frames) < most
        )

    whole = go(tmp_path / "whole", 99)
    assert len(whole.frames) == 6
    assert max(whole.tracks.values()) == 6
    world = [frame.world_T_camera for frame in whole.frames]
    assert 3.0 < np.linalg.norm(world[-1][:3, 3]) < 12.0
    assert go(tmp_path / "out", 2).stopped
    rest = go(tmp_path / "out", 99)
    assert rest.before == 2
    assert rows_of(rest.frames) == rows_of(whole.frames)


def test_what_was_looked_at_before_is_in_good_english():
    assert VideoRun(None, before=1).summary.endswith("; 1 was looked at before.")
    assert VideoRun(None, before=2).summary.endswith("; 2 were looked at before.")


def test_a_live_run_leaves_out_what_it_is_too_slow_for(drive, tmp_path):
    """What it looked at is stored: run again it gives the same, and left out stays what was."""

    class Slow(Counting):
        def record(self, frame, vehicles):
            if frame.image is not None:
                time.sleep(0.25)
            return super().record(frame, vehicles)

    def go(most):
        look = Slow(CAR14, given=read_given(drive[1], CAR14).vehicles)
        path, tracker = CameraPath(moving=True), SingleImageTracker(prior="car14")
        follower = Follower(tracker, GatedAssociation(), KITTI_CAMERA, ground=GROUND, path=path)
        return run_video(
            *(open_frames(drive[0], rate=10), look, follower, tmp_path / "out"),
            settings={"of": "a live one"},
            motion=MotionEstimator(KITTI_CAMERA, GROUND),
            online=LiveFrames(0.4),
            go_on=lambda run, _: len(run.frames) < most,
        )

    first = go(3)
    assert first.stopped
    assert not [thread.name for thread in threading.enumerate() if thread.name.startswith("fgrecon")]
    rest, again = go(99), go(99)
    assert [frame.number for frame in rest.frames] == [3, 4, 5, 6, 8, 9, 10, 11]
    assert 0 < rest.left_out < 7
    assert all(not frame.boxes for frame in rest.frames if frame.problem is not None)
    assert f"{rest.left_out} left out for newer ones" in rest.summary
    assert "ms, of 95 % up to" in rest.summary
    assert (again.before, again.left_out, again.delay_quantiles) == (8, rest.left_out, None)
    assert rows_of(again.frames) == rows_of(rest.frames)
    assert "000009.png" in rest.gaps or rest.frames[5].problem.endswith(LEFT_OUT)


def test_a_live_run_that_leaves_nothing_out_is_as_any_other(drive, tmp_path, monkeypatch):
    """Its motions are estimated beside what the frames show, and are the same."""

    class Every:
        delays = ()

        def __init__(self, frames, **_):
            self.frames = frames

        def __iter__(self):
            return iter(self.frames)

    monkeypatch.setattr("fgrecon.video.newest.Newest", Every)
    found, _ = run(drive, tmp_path / "live", moving=True, online=LiveFrames(60.0))
    whole, _ = run(drive, tmp_path / "whole", moving=True, online=True)
    assert found.left_out == 0
    assert rows_of(found.frames) == rows_of(whole.frames)
    assert found.way == whole.way
    assert not [thread.name for thread in threading.enumerate() if thread.name.startswith("fgrecon")]
