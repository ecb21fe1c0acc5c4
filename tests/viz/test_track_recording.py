"""Recordings of tracks: every frame and every joint step reads back to the last bit, on the right timelines."""

from __future__ import annotations

from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

import fgrecon
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.track_reconstruction import TrackReconstruction
from fgrecon.simulation.vehicles import KITTI_CAMERA, Vehicle, simulate, yaw_pose
from fgrecon.solve.track import reconstruct_track
from fgrecon.viz import TrackInputs, Truth, entities, replay, track_recording_of
from tests.results import changed
from tests.viz.test_recording import chunks, same

NUMBERS = (10, 11, 13, 14)


@pytest.fixture(scope="module")
def solved() -> tuple[TrackReconstruction, TrackInputs]:
    rng = np.random.default_rng(0)
    car = Vehicle.of_prior(fgrecon.load_prior("car14"), [0.5, -0.5, 0.0, 0.3, 0.0])
    poses = [yaw_pose(-2.2 + 0.2 * t, np.array([-3.0 + t, 1.65, 14.0 - t])) for t in range(4)]
    seen = [simulate(car, KITTI_CAMERA, pose, rng)[0] for pose in poses]
    seen[1] = None
    image = np.full((375, 1242, 3), 120, np.uint8)
    sight = TrackInputs(
        seen,
        [KITTI_CAMERA] * 4,
        NUMBERS,
        images=[image, image, None, image],
        truths=[Truth(poses[0], np.array([4.2, 1.8, 1.5]), car.keypoints), None, None, Truth(poses[3])],
        ground=fgrecon.Ground.level(1.65),
    )
    return reconstruct_track(seen, KITTI_CAMERA, ground=1.65), sight


@pytest.fixture(scope="module")
def recording(solved: tuple[TrackReconstruction, TrackInputs], tmp_path_factory: pytest.TempPathFactory) -> Path:
    return track_recording_of(*solved).write(tmp_path_factory.mktemp("track") / "track.rrd")


def test_every_frame_reads_back_to_the_last_bit(solved, recording: Path) -> None:
    track, _ = solved
    back = replay.read(recording)
    assert list(back.frames) == [10, 13, 14]
    for frame, steps in zip(track.frames, back.frames.values(), strict=True):
        assert len(steps) == len(frame.diagnostics.history)
        assert all(same(a, b) for a, b in zip(steps, frame.diagnostics.history, strict=True))
    assert len(back.history) == sum(len(frame.diagnostics.history) for frame in track.frames)


def test_every_joint_step_reads_back_to_the_last_bit(solved, recording: Path) -> None:
    track, _ = solved
    back = replay.read(recording).joint
    assert len(back) == len(track.history) > 0
    for a, b in zip(back, track.history, strict=True):
        for field in fields(a):
            left, right = getattr(a, field.name), getattr(b, field.name)
            if isinstance(left, np.ndarray):
                assert (left.shape, left.dtype, left.tobytes()) == (right.shape, right.dtype, right.tobytes())
            else:
                assert left == right


def test_plots_by_frame_and_by_step_equal_the_results(solved, recording: Path) -> None:
    track, sight = solved
    scalars = replay.read(recording).scalars
    weights = scalars[f"{entities.FRAMES}/{entities.WEIGHTS}"]
    assert (weights.timeline, weights.times.tolist()) == (entities.FRAME, [10, 13, 14])
    assert np.array_equal(weights.values, [frame.diagnostics.weights for frame in track.frames])
    energy = scalars[f"{entities.FRAMES}/{entities.ENERGY}"]
    assert energy["box"].tolist() == [frame.diagnostics.energies["box"] for frame in track.frames]
    joint = scalars[entities.ENERGY]
    assert joint.timeline == entities.STEP
    assert joint[entities.TOTAL].tolist() == [sum(step.energies.values()) for step in track.history]
    assert np.array_equal(scalars[entities.COEFFICIENTS].values, [step.coefficients for step in track.history])
    error = scalars[f"{entities.FRAMES}/{entities.ERROR}/translation_m"]
    assert error.times.tolist() == [10, 14]
    expected = np.linalg.norm(track.frames[0].location - sight.truths[0].camera_T_object[:3, 3])
    assert error.values[0, 0] == pytest.approx(expected, abs=1e-12)


def test_searches_follow_each_other_and_joint_steps_coincide(solved, recording: Path) -> None:
    track, _ = solved
    searched = [len(frame.diagnostics.history) - len(track.history) for frame in track.frames]
    (chunk,) = chunks(recording)[entities.HISTORY]
    columns = chunk.to_record_batch().to_pydict()
    rows = [[i for i, frame in enumerate(columns[entities.FRAME]) if frame == number] for number in (10, 13, 14)]
    steps = [sorted(columns[entities.STEP][i] for i in row) for row in rows]
    updates = [[columns[entities.IRLS][i] for i in row] for row in rows]
    assert all({columns[entities.STAGE][i] for i in row} == {0, 1, 2} for row in rows)
    joint = list(range(sum(searched), sum(searched) + len(track.history)))
    assert [row[count:] for row, count in zip(steps, searched, strict=True)] == [joint] * 3
    assert [step for row, count in zip(steps, searched, strict=True) for step in row[:count]] == list(range(joint[0]))
    assert len({tuple(row[-len(joint) :]) for row in updates}) == 1


def test_image_path_and_shape_are_there(solved, recording: Path) -> None:
    track, _ = solved
    found = chunks(recording)
    photographs = [chunk for chunk in found[entities.IMAGE] if not chunk.is_static]
    frames = [chunk.to_record_batch().to_pydict()[entities.FRAME] for chunk in photographs]
    assert sorted(frames) == [[10], [14]]
    (path,) = (chunk.to_record_batch().to_pydict() for chunk in found[entities.PATH] if not chunk.is_static)
    assert path[entities.FRAME] == [10, 13, 14]
    assert [len(strips[0]) for strips in path["LineStrips3D:strips"]] == [1, 2, 3]
    expected = [frame.location for frame in track.frames]
    np.testing.assert_allclose(path["LineStrips3D:strips"][-1][0], expected, rtol=1e-6)
    (true,) = (chunk.to_record_batch().to_pydict() for chunk in found[entities.TRUE_PATH] if not chunk.is_static)
    assert true[entities.FRAME] == [10, 14]
    assert len([chunk for chunk in found[entities.SURFACE] if not chunk.is_static]) == 1
    graph = {k: v for chunk in found[entities.GRAPH] for k, v in chunk.to_record_batch().to_pydict().items()}
    assert {"X(v=0,t=0)", "X(v=0,t=2)", "X(v=0,t=3)"} <= set(graph["GraphNodes:node_ids"][0])


def test_log_tells_of_every_image(solved, recording: Path) -> None:
    track, _ = solved
    lines = [line.text for line in replay.read(recording).log]
    assert lines[0] == "frame 11 was refused: no keypoints"
    assert [line.split(":")[0] for line in lines[1:4]] == ["frame 10", "frame 13", "frame 14"]
    assert lines[-1] == f"{track.status.value}: {track.message}"


def test_a_track_without_history_still_records(solved, tmp_path: Path) -> None:
    track, sight = solved
    frames = tuple(changed(frame, history=()) for frame in track.frames)
    bare = replace(track, frames=frames, history=(), graph=())
    recording = track_recording_of(bare, replace(sight, truths=None, images=None))
    back = replay.read(recording.write(tmp_path / "bare.rrd"))
    assert (back.history, back.joint) == ((), ())
    assert back.scalars[f"{entities.FRAMES}/{entities.WEIGHTS}"].values.shape == (3, 14)
    assert back.log[-1].text.startswith(track.status.value)


@pytest.mark.parametrize(
    ("field", "value"), [("cameras", [KITTI_CAMERA]), ("numbers", [1, 2]), ("numbers", [1, 2, 2, 3]), ("truths", [])]
)
def test_what_does_not_fit_the_images_is_refused(solved, field: str, value: object) -> None:
    with pytest.raises(InvalidInputError, match=field):
        replace(solved[1], **{field: value})
