"""Recordings: what is written reads back to the last bit, files are whole or absent, and every entity is there."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

from fgrecon import replay
from fgrecon.errors import InvalidInputError
from fgrecon.reconstruction import Iteration, Reconstruction, Status
from fgrecon.viz import entities, log_reconstruction, record
from tests.viz.made_up import STAGES, Example


@pytest.fixture(scope="module")
def recording(example: Example, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("recording") / "car.rrd"
    return record(
        path,
        example.reconstruction,
        example.observation,
        example.camera,
        image=example.image,
        truth=example.truth,
        ground=example.ground,
    )


def chunks(path: Path) -> dict[str, list]:
    from rerun.chunk import RrdReader

    found: dict[str, list] = {}
    for chunk in RrdReader(path).stream():
        found.setdefault(str(chunk.entity_path).strip("/"), []).append(chunk)
    return found


def same(a: Iteration, b: Iteration) -> bool:
    def equal(x, y) -> bool:
        if isinstance(x, np.ndarray):
            return x.dtype == y.dtype and x.shape == y.shape and x.tobytes() == y.tobytes()
        return x == y

    return all(equal(getattr(a, f.name), getattr(b, f.name)) for f in fields(Iteration))


def test_history_reads_back_to_the_last_bit(example: Example, recording: Path) -> None:
    history = replay.read(recording).history
    assert len(history) == len(example.reconstruction.history)
    assert all(same(a, b) for a, b in zip(history, example.reconstruction.history, strict=True))


def test_every_plotted_scalar_equals_the_history(example: Example, recording: Path) -> None:
    steps = example.reconstruction.history
    scalars = replay.read(recording).scalars
    for term in {term for step in steps for term in step.energies}:
        series = scalars[f"{entities.ENERGY}/{term}"]
        expected = [(i, step.energies[term]) for i, step in enumerate(steps) if term in step.energies]
        assert list(zip(series.steps.tolist(), series.values.tolist(), strict=True)) == expected
    total = scalars[f"{entities.ENERGY}/{entities.TOTAL}"]
    assert total.values.tolist() == [sum(step.energies.values()) for step in steps]
    assert np.array_equal(scalars[entities.WEIGHTS].values, [step.weights for step in steps])
    assert np.array_equal(scalars[entities.COEFFICIENTS].values, [step.coefficients for step in steps])
    errors = [example.truth.errors(step.camera_T_object, step.keypoints) for step in steps]
    for measure in errors[0]:
        assert scalars[f"{entities.ERROR}/{measure}"].values.tolist() == [error[measure] for error in errors]
    assert set(scalars) == (
        {f"{entities.ENERGY}/{term}" for term in ("reprojection", "prior", "dimensions", "total")}
        | {f"{entities.ERROR}/{measure}" for measure in errors[0]}
        | {entities.WEIGHTS, entities.COEFFICIENTS}
    )


def test_error_against_the_truth_falls(recording: Path) -> None:
    scalars = replay.read(recording).scalars
    for measure in ("orientation_deg", "translation_m", "keypoints_m"):
        values = scalars[f"{entities.ERROR}/{measure}"].values
        assert values[-1] < 0.2 * values[0]


def test_summary_lists_the_stages(example: Example, recording: Path) -> None:
    summary = replay.read(recording).summary()
    assert [(s.stage, s.weight_updates, s.steps) for s in summary] == [
        (stage, updates, updates * steps) for stage, (updates, steps) in STAGES.items()
    ]
    assert summary[0].first_energy == sum(example.reconstruction.history[0].energies.values())
    assert summary[-1].last_energy == sum(example.reconstruction.history[-1].energies.values())


def test_timelines_count_across_and_within_the_stages(example: Example, recording: Path) -> None:
    times: dict[str, list[int]] = {}
    for chunk in chunks(recording)[entities.HISTORY]:
        columns = chunk.to_record_batch().to_pydict()
        for timeline in chunk.timeline_names:
            times.setdefault(timeline, []).extend(columns[timeline])
    updates = sum(updates for updates, _ in STAGES.values())
    assert sorted(times[entities.STEP]) == list(range(len(example.reconstruction.history)))
    assert sorted(set(times[entities.IRLS])) == list(range(updates))
    for stage, (count, steps) in STAGES.items():
        assert times[stage] == list(range(count * steps))


def test_log_ends_with_status_and_message(example: Example, recording: Path) -> None:
    log = replay.read(recording).log
    updates = sum(updates for updates, _ in STAGES.values())
    assert len(log) == updates + 1
    assert log[-1].text == f"converged: {example.reconstruction.message}"
    assert log[-1].level == "INFO"
    assert log[0].text.startswith("initialisation, weight update 0: energy ")


def test_every_entity_is_there(recording: Path) -> None:
    found = chunks(recording)
    for entity in (
        entities.SCENE,
        entities.CAMERA,
        entities.IMAGE,
        entities.BOX_2D,
        entities.KEYPOINTS_2D,
        entities.RESIDUALS,
        entities.TRUTH_2D,
        entities.VEHICLE,
        entities.KEYPOINTS_3D,
        entities.SURFACE,
        entities.VEHICLE_BOX,
        entities.UNCERTAINTY,
        f"{entities.TRUTH_3D}/box",
        f"{entities.TRUTH_3D}/keypoints",
        entities.GROUND,
        entities.SUMMARY,
        *(
            f"{wireframe}/{side}"
            for wireframe in (entities.WIREFRAME_2D, entities.WIREFRAME_3D)
            for side in ("left", "right", "across")
        ),
    ):
        assert entity in found, entity


def test_drawn_geometry_is_the_history(example: Example, recording: Path) -> None:
    last = example.reconstruction.history[-1]
    found = chunks(recording)

    def at_end(entity: str, component: str) -> np.ndarray:
        for chunk in found[entity]:
            columns = chunk.to_record_batch().to_pydict()
            if (
                component in columns
                and not chunk.is_static
                and columns[entities.STEP][-1] == len(example.reconstruction.history) - 1
            ):
                return np.array(columns[component][-1])
        raise AssertionError(entity)

    measured = example.observation.measured
    keypoints = at_end(entities.KEYPOINTS_2D, "Points2D:positions")
    assert np.array_equal(keypoints, example.observation.keypoints[measured].astype(np.float32))
    assert np.array_equal(at_end(entities.KEYPOINTS_3D, "Points3D:positions"), last.keypoints.astype(np.float32))
    residuals = at_end(entities.RESIDUALS, "LineStrips2D:strips")
    assert residuals.shape == (measured.sum(), 2, 2)
    assert np.abs(residuals[:, 1] - last.projections[measured]).max() < 1e-3
    translation = at_end(entities.VEHICLE, "Transform3D:translation")[0]
    assert np.array_equal(translation, last.camera_T_object[:3, 3].astype(np.float32))
    surface = at_end(entities.SURFACE, "Mesh3D:vertex_positions")
    assert np.array_equal(surface, example.reconstruction.surface_vertices.astype(np.float32))


def test_layout_is_stored_in_the_file(recording: Path) -> None:
    from rerun.chunk import RrdReader

    assert len(RrdReader(recording).blueprints()) == 1
    assert len(RrdReader(recording).recordings()) == 1


def test_a_failed_result_without_history_still_records(example: Example, tmp_path: Path) -> None:
    failed = replace(
        example.reconstruction,
        status=Status.FAILED,
        message="every keypoint lies on one line",
        camera_T_object=np.full((4, 4), np.nan),
        coefficients=np.zeros(0),
        wireframe=np.full_like(example.reconstruction.wireframe, np.nan),
        wireframe_uv=np.full_like(example.reconstruction.wireframe_uv, np.nan),
        box_size=np.full(3, np.nan),
        keypoint_covariance=None,
        history=(),
        surface_vertices=None,
        surface_faces=None,
        milliseconds={},
    )
    path = record(tmp_path / "failed.rrd", failed, example.observation, example.camera, truth=example.truth)
    back = replay.read(path)
    assert back.history == ()
    assert back.summary() == ()
    assert [(line.step, line.level, line.text) for line in back.log] == [
        (None, "ERROR", "failed: every keypoint lies on one line")
    ]


def test_a_result_without_history_is_its_only_step(example: Example, tmp_path: Path) -> None:
    bare = replace(example.reconstruction, history=())
    path = record(tmp_path / "bare.rrd", bare, example.observation, example.camera)
    back = replay.read(path)
    assert back.history == ()
    assert back.scalars[entities.WEIGHTS].values.tolist() == [bare.weights.tolist()]
    assert back.scalars[f"{entities.ENERGY}/{entities.TOTAL}"].values.tolist() == [sum(bare.energies.values())]
    assert [line.step for line in back.log] == [0, 0]
    assert {entities.KEYPOINTS_2D, entities.SURFACE, f"{entities.WIREFRAME_2D}/left"} <= set(chunks(path))


def test_what_is_not_given_is_not_drawn(example: Example, tmp_path: Path) -> None:
    bare = replace(example.reconstruction, surface_vertices=None, surface_faces=None, keypoint_covariance=None)
    observation = replace(example.observation, box=None)
    found = chunks(record(tmp_path / "bare.rrd", bare, observation, example.camera))
    assert entities.KEYPOINTS_2D in found
    for entity in (
        entities.IMAGE,
        entities.BOX_2D,
        entities.TRUTH_2D,
        entities.SURFACE,
        entities.UNCERTAINTY,
        f"{entities.TRUTH_3D}/box",
    ):
        assert entity not in found


def test_points_behind_the_camera_are_left_out(example: Example, tmp_path: Path) -> None:
    behind = np.diag([1.0, 1.0, 1.0, 1.0])
    behind[:3, 3] = (0.0, 0.0, -8.0)
    steps = (replace(example.reconstruction.history[0], camera_T_object=behind), *example.reconstruction.history[1:])
    result: Reconstruction = replace(example.reconstruction, history=steps)
    path = record(tmp_path / "behind.rrd", result, example.observation, example.camera)
    assert np.array_equal(replay.read(path).history[0].camera_T_object, behind)
    drawn = [
        len(strips)
        for chunk in chunks(path)[entities.RESIDUALS]
        if not chunk.is_static
        for strips in chunk.to_record_batch().to_pydict()["LineStrips2D:strips"]
    ]
    assert drawn == [0] + [int(example.observation.measured.sum())] * (len(steps) - 1)


def test_a_stream_of_ones_own_gets_the_same(example: Example, tmp_path: Path) -> None:
    import rerun as rr

    path = tmp_path / "own.rrd"
    stream = rr.RecordingStream("test")
    stream.save(path)
    log_reconstruction(stream, example.reconstruction, example.observation, example.camera)
    stream.flush()
    stream.disconnect()
    assert len(replay.read(path).history) == len(example.reconstruction.history)


@pytest.mark.parametrize("where", ["nowhere/car.rrd", "folder", "file/car.rrd"])
def test_a_path_that_cannot_be_written_leaves_nothing_behind(example: Example, tmp_path: Path, where: str) -> None:
    (tmp_path / "folder").mkdir()
    (tmp_path / "file").write_text("kept")
    with pytest.raises(InvalidInputError, match="folder that exists"):
        record(tmp_path / where, example.reconstruction, example.observation, example.camera)
    assert sorted(p.name for p in tmp_path.rglob("*")) == ["file", "folder"]
    assert (tmp_path / "file").read_text() == "kept"


@pytest.mark.parametrize("image", [np.zeros((4, 4), np.uint8), np.zeros((4, 4, 3)), np.zeros((0, 4, 3), np.uint8)])
def test_an_image_of_another_kind_is_refused(example: Example, tmp_path: Path, image: np.ndarray) -> None:
    with pytest.raises(InvalidInputError, match="image"):
        record(tmp_path / "x.rrd", example.reconstruction, example.observation, example.camera, image=image)
    assert not list(tmp_path.iterdir())


def test_reading_something_else_is_refused(tmp_path: Path) -> None:
    (tmp_path / "text.rrd").write_text("no recording")
    for name in ("text.rrd", "absent.rrd"):
        with pytest.raises(InvalidInputError, match="recording"):
            replay.read(tmp_path / name)


def test_importing_loads_no_viewer() -> None:
    code = "import sys, fgrecon.viz, fgrecon.replay; print({'rerun', 'matplotlib', 'torch', 'cv2'} & set(sys.modules))"
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert out.stdout.strip() == "set()"
