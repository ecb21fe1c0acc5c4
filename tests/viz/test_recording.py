"""Recordings: what is written reads back to the last bit, files are whole or absent, and every entity is there."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

from fgrecon.core.errors import InvalidInputError
from fgrecon.core.reconstruction import Alternative, Iteration, Reconstruction, Status
from fgrecon.viz import SolvedVehicle, entities, recording_of, replay, style
from fgrecon.viz.replay import _read
from tests.results import changed
from tests.viz.made_up import STAGES, Example, record


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
    assert len(history) == len(example.reconstruction.diagnostics.history)
    assert all(same(a, b) for a, b in zip(history, example.reconstruction.diagnostics.history, strict=True))


def test_every_plotted_scalar_equals_the_history(example: Example, recording: Path) -> None:
    steps = example.reconstruction.diagnostics.history
    scalars = replay.read(recording).scalars
    energy = scalars[entities.ENERGY]
    assert energy.names == ("reprojection", "prior", "dimensions", entities.TOTAL)
    assert (energy.timeline, energy.times.tolist()) == (entities.STEP, list(range(len(steps))))
    for term in energy.names[:-1]:
        expected = np.array([step.energies.get(term, np.nan) for step in steps])
        assert energy[term].tobytes() == expected.tobytes()
    assert energy[entities.TOTAL].tolist() == [sum(step.energies.values()) for step in steps]
    assert np.array_equal(scalars[entities.WEIGHTS].values, [step.weights for step in steps])
    assert scalars[entities.WEIGHTS].names[0] == "left front wheel"
    assert np.array_equal(scalars[entities.COEFFICIENTS].values, [step.coefficients for step in steps])
    errors = [example.truth.errors(step.camera_T_object, step.keypoints) for step in steps]
    for measure in errors[0]:
        series = scalars[f"{entities.ERROR}/{measure}"]
        assert series.values[:, 0].tolist() == [error[measure] for error in errors]
    assert set(scalars) == {f"{entities.ERROR}/{measure}" for measure in errors[0]} | {
        entities.ENERGY,
        entities.WEIGHTS,
        entities.COEFFICIENTS,
    }
    with pytest.raises(KeyError, match="unknown"):
        energy["unknown"]


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
    assert summary[0].first_energy == sum(example.reconstruction.diagnostics.history[0].energies.values())
    assert summary[-1].last_energy == sum(example.reconstruction.diagnostics.history[-1].energies.values())


def test_timelines_count_steps_stages_updates_and_frames(example: Example, recording: Path) -> None:
    (chunk,) = chunks(recording)[entities.HISTORY]
    columns = chunk.to_record_batch().to_pydict()
    steps = example.reconstruction.diagnostics.history
    updates = list(dict.fromkeys((step.stage, step.irls) for step in steps))
    assert columns[entities.STEP] == list(range(len(steps)))
    assert columns[entities.STAGE] == [list(STAGES).index(step.stage) for step in steps]
    assert columns[entities.IRLS] == [updates.index((step.stage, step.irls)) for step in steps]
    assert columns[entities.FRAME] == [0] * len(steps)
    assert set(chunk.timeline_names) == {entities.STEP, entities.STAGE, entities.IRLS, entities.FRAME}


def test_log_says_why_each_stage_and_all_of_it_stopped(example: Example, recording: Path) -> None:
    log = replay.read(recording).log
    updates = sum(updates for updates, _ in STAGES.values())
    assert len(log) == updates + len(STAGES) + 1
    assert log[-1].text == f"converged: {example.reconstruction.message}"
    assert log[-1].level == "INFO"
    assert log[0].text.startswith("initialisation 0: energy ")
    assert log[1].text == "initialisation ended after one weight update"
    ends = [line.text for line in log if " ended after update " in line.text]
    assert [text.partition(" ")[0] for text in ends] == ["pose", "shape", "joint"]
    first, last = (example.reconstruction.diagnostics.history[i].weights for i in (-4, -1))
    assert f"weights still changed by {np.abs(last - first).max():.2g}," in ends[-1]


def test_the_previous_estimate_is_that_of_the_weight_update_before(example: Example, recording: Path) -> None:
    steps = example.reconstruction.diagnostics.history
    (drawn,) = (chunk for chunk in chunks(recording)[entities.PREVIOUS_3D] if not chunk.is_static)
    strips = drawn.to_record_batch().to_pydict()["LineStrips3D:strips"]
    last = max(i for i, step in enumerate(steps) if (step.stage, step.irls) == ("joint", 0))
    pose = steps[last].camera_T_object
    expected = steps[last].keypoints @ pose[:3, :3].T + pose[:3, 3]
    np.testing.assert_allclose(strips[-1], expected[example.reconstruction.shape.edges], atol=1e-5)
    assert strips[0] == strips[1]  # before the second update lies the first


def test_planes_lie_where_the_keypoints_are(example: Example, recording: Path) -> None:
    found, result = chunks(recording), example.reconstruction
    for name in (*result.shape.faces, entities.MEDIAL):
        (drawn,) = (chunk for chunk in found[f"{entities.PLANES}/{name}"] if not chunk.is_static)
        corners = np.array(drawn.to_record_batch().to_pydict()["Mesh3D:vertex_positions"][-1])
        if name == entities.MEDIAL:
            assert np.abs(corners[:, 2]).max() < 1e-6
            assert np.ptp(corners[:, 0]) > 3.0
        else:
            assert np.abs(corners - result.wireframe[list(result.shape.faces[name])]).max() < 0.02
            assert np.linalg.matrix_rank(corners - corners.mean(axis=0), tol=1e-5) == 2


def test_the_factor_graph_has_every_factor_and_its_variables(example: Example, recording: Path) -> None:
    graph = example.reconstruction.diagnostics.graph
    found = chunks(recording)[entities.GRAPH]
    (moving,) = (chunk for chunk in found if not chunk.is_static)
    columns = {k: v for chunk in found if chunk.is_static for k, v in chunk.to_record_batch().to_pydict().items()}
    variables = ["X(v=0,t=0)", "L(v=0)", "P(v=0,f=0)"]
    nodes = columns["GraphNodes:node_ids"][0]
    assert nodes == variables + [f"{factor.term} {i}" for i, factor in enumerate(graph)]
    expected = [(f"{factor.term} {i}", variable) for i, factor in enumerate(graph) for variable in factor.variables]
    edges = [tuple(edge.values()) for edge in columns["GraphEdges:edges"][0]]
    assert edges == expected
    assert len({tuple(place) for place in columns["GraphNodes:positions"][0]}) == len(nodes)
    colours = np.array(moving.to_record_batch().to_pydict()["GraphNodes:colors"])
    weights = np.array([step.weights[0] for step in example.reconstruction.diagnostics.history])
    assert len(set(colours[:, 3])) == len(np.unique(style.readable(style.weight_colours(weights)), axis=0))
    assert len(set(colours[:, 0])) == 1


def test_every_entity_is_there(recording: Path) -> None:
    found = chunks(recording)
    for entity in (
        entities.SCENE,
        entities.CAMERA,
        entities.IMAGE,
        entities.BOX_2D,
        entities.KEYPOINTS_2D,
        entities.RESIDUALS,
        entities.PREVIOUS_2D,
        entities.TRUTH_2D,
        entities.VEHICLE,
        entities.GRAPH,
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
    last = example.reconstruction.diagnostics.history[-1]
    found = chunks(recording)

    def at_end(entity: str, component: str) -> np.ndarray:
        for chunk in found[entity]:
            columns = chunk.to_record_batch().to_pydict()
            if (
                component in columns
                and not chunk.is_static
                and columns[entities.STEP][-1] == len(example.reconstruction.diagnostics.history) - 1
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
    assert np.array_equal(surface, example.reconstruction.shape.surface_vertices.astype(np.float32))


def test_a_failed_result_without_history_still_records(example: Example, tmp_path: Path) -> None:
    failed = changed(
        example.reconstruction,
        status=Status.FAILED,
        message="every keypoint lies on one line",
        camera_T_object=np.full((4, 4), np.nan),
        coefficients=np.zeros(0),
        wireframe=np.full_like(example.reconstruction.wireframe, np.nan),
        wireframe_uv=np.full_like(example.reconstruction.pose.wireframe_uv, np.nan),
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
    bare = changed(example.reconstruction, history=())
    path = record(tmp_path / "bare.rrd", bare, example.observation, example.camera)
    back = replay.read(path)
    assert back.history == ()
    assert back.scalars[entities.WEIGHTS].values.tolist() == [bare.diagnostics.weights.tolist()]
    assert back.scalars[entities.ENERGY][entities.TOTAL].tolist() == [sum(bare.diagnostics.energies.values())]
    assert [line.step for line in back.log] == [0, 0, 0]
    assert {entities.KEYPOINTS_2D, entities.SURFACE, f"{entities.WIREFRAME_2D}/left"} <= set(chunks(path))


def test_what_is_not_given_is_not_drawn(example: Example, tmp_path: Path) -> None:
    bare = changed(example.reconstruction, surface_vertices=None, surface_faces=None, keypoint_covariance=None)
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
    steps = (
        replace(example.reconstruction.diagnostics.history[0], camera_T_object=behind),
        *example.reconstruction.diagnostics.history[1:],
    )
    result: Reconstruction = changed(example.reconstruction, history=steps)
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
    recording_of(SolvedVehicle(example.reconstruction, example.observation, example.camera)).make()(stream)
    stream.flush()
    stream.disconnect()
    assert len(replay.read(path).history) == len(example.reconstruction.diagnostics.history)


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
    for name in ("text.rrd", f"{'long' * 50}.rrd"):
        (tmp_path / name).write_text("no recording")
        with pytest.raises(InvalidInputError, match=r"recording: got .*The reason: \S"):
            replay.read(tmp_path / name)
    with pytest.raises(InvalidInputError, match="recording"):
        replay.read(tmp_path / "absent.rrd")


@pytest.mark.parametrize("level", [[["INFO"], []], [["INFO"], None], [["INFO"]]])
def test_a_recording_whose_rows_are_empty_or_null_is_refused(monkeypatch: pytest.MonkeyPatch, level: object) -> None:
    columns = {"TextLog:text": [["one"], ["two"]], "TextLog:level": level, entities.STEP: [0, 1]}
    monkeypatch.setattr("fgrecon.viz.replay._chunks", lambda _: [(entities.LOG, columns)])
    with pytest.raises(InvalidInputError, match=r"a\.rrd.*The reason: "):
        _read(Path("a.rrd"))


def test_importing_loads_no_viewer() -> None:
    code = (
        "import sys, fgrecon.viz, fgrecon.viz.replay; print({'rerun', 'matplotlib', 'torch', 'cv2'} & set(sys.modules))"
    )
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert out.stdout.strip() == "set()"


def test_other_poses_that_may_be_are_arrows_along_their_headings(example: Example, tmp_path: Path) -> None:
    turned, away = np.eye(4), np.eye(4)
    turned[:3, 3], away[:3, 3] = (1.0, 1.65, 9.0), (1.0, 1.65, 90.0)
    lambdas = example.reconstruction.shape.coefficients
    others = Alternative(turned, lambdas, 1.0, 0.25), Alternative(away, lambdas, 9.0, 0.001)
    result = changed(example.reconstruction, alternatives=others)
    path = recording_of(SolvedVehicle(result, example.observation, example.camera)).write(tmp_path / "car.rrd")
    (drawn,) = (chunk for chunk in chunks(path)[entities.ALTERNATIVES] if not chunk.is_static)
    columns = drawn.to_record_batch().to_pydict()
    assert columns["Arrows3D:labels"] == [["25 %"]]
    np.testing.assert_allclose(columns["Arrows3D:origins"], [[turned[:3, 3]]])
    ((ahead,),) = np.array(columns["Arrows3D:vectors"])
    assert ahead[0] > result.box_size[0] / 2
    np.testing.assert_allclose(ahead[1:], 0.0)
