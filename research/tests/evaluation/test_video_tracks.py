"""Labelled boxes that are followed over time, on the made-up drive of single images and on copies of its image."""

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest

from fgrecon.calibration.labelled_boxes import SYSTEM
from fgrecon.calibration.labelled_frames import score_frames
from fgrecon.core.depth_map import DepthMap
from fgrecon.core.errors import ContradictoryInputWarning
from fgrecon.core.evidence import Points
from fgrecon.core.geometry import yaw_rotation
from fgrecon.core.half_turn import flipped_observation
from fgrecon.io.kitti_files import read_drive
from fgrecon.video.egomotion import CameraMotion
from fgrecon_research.evaluation import video_tracks
from fgrecon_research.evaluation.video_summary import document, summarise_boxes, summarise_groups
from fgrecon_research.evaluation.video_tracks import (
    ALONE,
    BATCH,
    BATCH_MOVING,
    ONLINE,
    ONLINE_MOVING,
    SIGN_BELIEF,
    VOTE,
    VOTE_BATCH,
    follow_boxes,
    labelled_velocities,
)
from fgrecon_research.io.drive_sensors import Sensor
from research.tests.evaluation.test_video_images import folder, setup  # noqa: F401  # fixtures


def test_a_track_of_one_box_is_a_single_image(folder, setup, scene):  # noqa: F811
    setup, drives = replace(setup, together=False), [read_drive(folder)]
    frames = score_frames(drives, {"drive": setup})
    boxes = [box for frame in frames for box in frame.boxes]
    followed = follow_boxes(frames, drives, {"drive": setup})
    for box, before in zip(followed, boxes, strict=True):
        alone = before.outcomes[SYSTEM]
        for method in (ONLINE, BATCH):
            found = box.outcomes[method]
            assert (found.degrees, found.size, found.status) == (alone.degrees, alone.size, alone.status)
            assert found.metres == alone.metres
        assert box.outcomes[SYSTEM] == alone
    assert followed[2].outcomes[ONLINE].failure == "no estimate"


def test_several_images_and_how_much_errors_change(folder, setup, scene):  # noqa: F811
    lines = (folder / "label_02.txt").read_text().splitlines()
    for number in (1, 2, 6):
        shutil.copy(folder / "image_02" / "000000.png", folder / "image_02" / f"{number:06d}.png")
    (folder / "label_02.txt").write_text(
        "".join(f"{number} {line.split(maxsplit=1)[1]}\n" for number in (0, 1, 2, 6) for line in lines)
    )
    clean = json.loads((folder / "clean_tracks.json").read_text())
    (folder / "clean_tracks.json").write_text(json.dumps({name: [0, 1, 2, 6] for name in clean}))
    drives = [read_drive(folder)]
    frames = score_frames(drives, {"drive": setup})
    boxes = follow_boxes(frames, drives, {"drive": setup}, estimate_motion=True)
    first = [box for box in boxes if box.track == 0]
    assert len(first) == 4
    for method in (ONLINE, BATCH, ONLINE_MOVING, BATCH_MOVING):  # the camera stands
        assert max(box.outcomes[method].degrees for box in first) < 1.5
        assert max(box.outcomes[method].metres for box in first) < 0.2
    alone, online = (summarise_boxes(first, method) for method in (SYSTEM, ONLINE))
    assert alone.jitter_metres == pytest.approx(0.0, abs=1e-9)  # the images are one
    offs = [box.outcomes[ONLINE].off for box in first[:3]]  # the last comes too late to count
    assert online.jitter_metres == pytest.approx(np.linalg.norm(np.diff(offs, axis=0)[:, 1:], axis=1).mean())
    assert online.jitter_degrees == pytest.approx(np.abs(np.diff(offs, axis=0)[:, 0]).mean())
    assert alone.intervals["mean_absolute_size_error"].value == pytest.approx(
        np.abs(first[0].outcomes[SYSTEM].size).mean()
    )
    made = document(boxes, summarise_groups(boxes), {}, [])
    tracked = [ALONE, VOTE, VOTE_BATCH, SIGN_BELIEF, ONLINE, BATCH, ONLINE_MOVING, BATCH_MOVING]
    assert list(made["methods"]) == [SYSTEM, *tracked]
    alone = [box.outcomes[ALONE] for box in first]
    assert alone[0].metres == alone[1].metres > 0.0  # the images are one
    consistency = made["methods"][ONLINE]["regime"]["all"]["consistency"]
    assert consistency["position"]["low"] < 1.0 < consistency["position"]["high"]
    assert set(consistency) >= {"position", "yaw"}
    row = next(row for row in made["boxes"] if row["method"] == ONLINE)
    assert row["position_nees"] > 0.0
    json.dumps(made, allow_nan=False)


def to_the_right(folder):  # noqa: F811
    """A drive in which the first car goes 0.5 m to the right from frame to frame, and the network sees it stand."""
    _, first, *_ = (folder / "label_02.txt").read_text().splitlines()
    columns = first.split()
    lines = []
    for number in range(6):
        if number:
            shutil.copy(folder / "image_02" / "000000.png", folder / "image_02" / f"{number:06d}.png")
        moved = [*columns]
        moved[0], moved[13] = str(number), str(float(columns[13]) + 0.5 * number)
        lines.append(" ".join(moved))
    (folder / "label_02.txt").write_text("\n".join(lines) + "\n")
    (folder / "clean_tracks.json").unlink(missing_ok=True)
    return read_drive(folder)


def test_labels_make_velocities(folder, setup, scene):  # noqa: F811
    drive = to_the_right(folder)
    (track,) = {int(number) for frame in drive.frames for number in frame.tracks}
    velocities = labelled_velocities(drive)
    assert sorted(velocities) == [(n, track) for n in (1, 2, 3, 4)]  # ahead of the first and behind the last are none
    for velocity in velocities.values():
        np.testing.assert_allclose(velocity, [5.0, 0.0, 0.0], atol=1e-9)
    boxes = follow_boxes(score_frames([drive], {"drive": setup}), [drive], {"drive": setup})
    errors = [box.outcomes[BATCH].velocity for box in boxes]
    assert [error is None for error in errors] == [True, False, False, False, False, True]
    assert errors[2] == pytest.approx(5.0, abs=0.3)
    assert boxes[2].outcomes[BATCH].squared["velocity"] > 0.0
    assert summarise_boxes(boxes, BATCH).intervals["median_velocity"].value == pytest.approx(5.0, abs=0.3)


def test_velocities_with_the_cameras_motion_are_as_far_off_as_those_relative_to_it(
    folder,  # noqa: F811
    setup,  # noqa: F811
    scene,
    monkeypatch,
):
    drive, step = to_the_right(folder), np.eye(4)
    step[:3, :3], step[:3, 3] = yaw_rotation(0.03), (0.0, 0.0, 0.7)
    motion = CameraMotion(step, np.diag([1e-8] * 3 + [1e-6] * 3), 100)
    monkeypatch.setattr(video_tracks, "MotionEstimator", lambda *_: lambda image, sightings: motion)
    frames = score_frames([drive], {"drive": setup})
    boxes = follow_boxes(frames, [drive], {"drive": setup}, estimate_motion=True)
    for method in (ONLINE_MOVING, BATCH_MOVING):
        errors = [box.outcomes[method].velocity for box in boxes]
        assert [error is None for error in errors] == [True, False, False, False, False, True]
        assert errors[2:5] == pytest.approx([5.0] * 3, abs=0.5)
        assert all("velocity" not in box.outcomes[method].squared for box in boxes)


def test_labels_make_velocities_over_the_world(folder):  # noqa: F811
    drive, track = to_the_right(folder), 0
    place, step = drive.frames[0].objects.location[0] + drive.calibration.label_offset, np.array([0.5, 0.0, 0.0])
    poses = {number: np.eye(4) for number in range(6)}
    for number, pose in poses.items():  # the car stands: the camera goes and turns
        pose[:3, :3] = yaw_rotation(0.1 * number)
        pose[:3, 3] = -pose[:3, :3] @ (place + number * step)
    for velocity in labelled_velocities(drive, poses).values():
        np.testing.assert_allclose(velocity, 0.0, atol=1e-9)
    for pose in poses.values():
        pose[:3, 3] = 0.0  # it turns on the spot
    turning = np.array([np.linalg.inv(poses[2]) @ poses[n] @ [*(place + n * step), 1.0] for n in range(5)])[:, :3]
    expected = np.polyfit(0.1 * np.arange(5), turning, 1)[0]
    np.testing.assert_allclose(labelled_velocities(drive, poses)[2, track], expected, atol=1e-9)
    del poses[3]
    assert labelled_velocities(drive, poses) == {}  # each has the lost camera among its labels
    assert len(labelled_velocities(drive)) == 4


def test_the_vote_turns_single_images_round(folder, setup, scene):  # noqa: F811
    """The van is flipped in the second frame, by a network that is less sure of it than of the others."""
    _, _, van, *_ = (folder / "label_02.txt").read_text().splitlines()
    for number in range(1, 3):
        shutil.copy(folder / "image_02" / "000000.png", folder / "image_02" / f"{number:06d}.png")
    (folder / "label_02.txt").write_text("".join(f"{n} {van.split(maxsplit=1)[1]}\n" for n in range(3)))
    (folder / "clean_tracks.json").unlink()
    drive = read_drive(folder)
    for together in (True, False):
        setups = {"drive": replace(setup, together=together)}
        frames = score_frames([drive], setups)
        (seen,) = frames[1].sightings
        unsure = 0.9 * seen.observation.azimuth + 0.1 / len(seen.observation.azimuth)
        other = flipped_observation(replace(seen.observation, azimuth=unsure), setup.prior)
        frames[1] = replace(frames[1], sightings=(replace(seen, observation=other),))
        boxes = follow_boxes(frames, [drive], setups)
        by_itself = frames[0].boxes[0].outcomes[SYSTEM]
        assert by_itself.degrees == pytest.approx(180.0, abs=1.0)  # the network is wrong in the others
        for method in (VOTE, VOTE_BATCH):
            assert [box.outcomes[method].degrees > 90.0 for box in boxes] == [True] * 3
            assert boxes[1].outcomes[method].degrees == pytest.approx(180.0, abs=1.0)
        flips = [box.outcomes[SIGN_BELIEF].degrees > 90.0 for box in boxes]
        assert flips == [True, False, True]  # the last of two votes counts a little more, however sure they are
        assert (ALONE in boxes[1].outcomes) == together
        if together:
            assert boxes[1].outcomes[ALONE].degrees < 90.0
            assert boxes[1].outcomes[ALONE].metres == boxes[1].outcomes[VOTE].metres


def test_the_belief_of_a_sign_forgets():
    """Oracle: the Kalman filter's closed form for one vote, and the stationary one for votes without end."""
    (once,) = video_tracks._sign_belief(np.array([3.0]), [0.0])
    assert once == pytest.approx(0.5)
    first, later = video_tracks._sign_belief(np.array([3.0, 0.0]), [0.0, 2.0])
    assert later == pytest.approx(first * np.exp(-2.0))
    always = video_tracks._sign_belief(np.full(400, 0.2), [0.1 * i for i in range(400)])
    kept = np.exp(-0.1)
    prior = np.roots([1.0, 1.0 - kept**2 - (1.0 - kept**2), -(1.0 - kept**2)]).max()  # of the Riccati equation
    gain = prior / (prior + 1.0)
    assert always[-1] == pytest.approx(gain / (1.0 - (1.0 - gain) * kept), rel=1e-6)
    turned = video_tracks._sign_belief(np.array([5.0] * 30 + [-0.1] * 30), [0.1 * i for i in range(60)])
    assert turned[29] > 0.0 > turned[-1]  # the vote of the sums would never turn


def test_a_lidar_s_points_are_given_to_what_follows(folder, setup, scene, monkeypatch):  # noqa: F811
    setup, drives = replace(setup, together=False), [read_drive(folder)]
    given = []

    def scan(frame):
        given.append(frame.number)
        return Points(np.array([[0.0, 1.0, 9.0], [0.2, 1.0, 9.0], [0.4, 1.0, 9.0], [0.0, 0.8, 9.0]]))

    monkeypatch.setattr(video_tracks, "scan_of", scan)
    frames = score_frames(drives, {"drive": setup})
    followed = follow_boxes(frames, drives, {"drive": setup}, sensors=[Sensor.LIDAR])
    assert given == [frame.number for frame in frames]
    assert len(followed) == sum(len(frame.boxes) for frame in frames)


def test_right_images_are_given_to_what_follows(folder, setup, scene, monkeypatch):  # noqa: F811
    setup, drives = replace(setup, together=False), [read_drive(folder)]
    images, given, flat = drives[0].frames[0].image.parent, [], DepthMap(np.full((360, 1200), 20.0))
    shutil.copytree(images, images.parent / "image_03")
    monkeypatch.setattr(video_tracks, "right_image", lambda frame: frame.number)
    monkeypatch.setattr(video_tracks, "stereo_depth", lambda left, camera, pair: given.append(pair) or flat)
    frames = score_frames(drives, {"drive": setup})
    with pytest.warns(ContradictoryInputWarning, match="The depth map is not where the image shows the vehicles"):
        follow_boxes(frames, drives, {"drive": setup}, sensors=[Sensor.RIGHT])
    assert given == [frame.number for frame in frames]
