"""One recording for all vehicles of an image: shared things once, each vehicle in a branch, all readable again."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fgrecon.core.errors import InvalidInputError
from fgrecon.core.reconstruction import Status
from fgrecon.core.vehicle_mesh import VehicleMesh
from fgrecon.viz import SolvedVehicle, entities, replay
from fgrecon.viz.describe import scene_table
from fgrecon.viz.subjects import members_of
from tests.results import changed
from tests.viz.made_up import Example, record, record_scene
from tests.viz.test_blueprint import layout_of
from tests.viz.test_picture import failed
from tests.viz.test_recording import chunks, same

TITLES = ("a/b", "a b", "third")


@pytest.fixture(scope="module")
def sights(example: Example) -> list[SolvedVehicle]:
    """Three vehicles: one with a shorter history, one that is ambiguous and ends up facing the other way."""
    turned = example.reconstruction.camera_T_object.copy()
    turned[:3, [0, 2]] *= -1
    history = example.reconstruction.diagnostics.history
    results = (
        example.reconstruction,
        changed(example.reconstruction, history=history[:7]),
        changed(
            example.reconstruction,
            status=Status.AMBIGUOUS,
            history=(*history[:5], replace(history[-1], camera_T_object=turned)),
        ),
    )
    return [
        SolvedVehicle(result, example.observation, example.camera, example.image, title=title)
        for title, result in zip(TITLES, results, strict=True)
    ]


@pytest.fixture(scope="module")
def recording(sights, example, tmp_path_factory) -> Path:
    return record_scene(tmp_path_factory.mktemp("scene") / "scene.rrd", sights, ground=example.ground)


def values(parts: list, component: str) -> list:
    rows = [chunk.to_record_batch().to_pydict() for chunk in parts]
    return [value for row in rows if component in row for value in row[component]]


def test_every_vehicle_reads_back_to_the_last_bit(sights, recording) -> None:
    read = replay.read(recording)
    assert list(read.vehicles) == ["a-b", "a-b-2", "third"]
    for sight, vehicle in zip(sights, read.vehicles.values(), strict=True):
        history = sight.reconstruction.diagnostics.history
        assert len(vehicle.history) == len(history)
        assert all(same(a, b) for a, b in zip(vehicle.history, history, strict=True))
        assert vehicle.log[-1].text.startswith(sight.reconstruction.status.value)
        assert {entities.ENERGY, entities.WEIGHTS} <= set(vehicle.scalars)
    assert read.frames == {}
    assert len(read.history) == sum(len(sight.reconstruction.diagnostics.history) for sight in sights)
    pose = next(stage for stage in read.summary() if stage.stage == "pose")
    assert pose.steps == sum(
        stage.steps for v in read.vehicles.values() for stage in v.summary() if stage.stage == "pose"
    )


def test_what_they_share_is_there_once(recording) -> None:
    found = chunks(recording)
    assert len(values(found[entities.IMAGE], "EncodedImage:blob")) == 1
    assert len(values(found[entities.CAMERA], "Pinhole:image_from_camera")) == 1
    (ground,) = values(found[entities.GROUND], "LineStrips3D:strips")
    assert len(ground) > 5
    (labels,) = values(found[entities.BOXES_2D], "Boxes2D:labels")
    assert labels == list(TITLES)
    (table,) = values(found[entities.SUMMARY], "TextDocument:text")
    assert all(title in table[0] for title in TITLES)


def test_a_vehicle_is_recorded_as_it_would_be_alone(sights, recording, example, tmp_path) -> None:
    """Every entity of a vehicle's own recording is in its branch, apart from what all share."""
    alone = chunks(record(tmp_path / "car.rrd", sights[0].reconstruction, example.observation, example.camera))
    shared = {entities.SCENE, entities.CAMERA, entities.GROUND, entities.BOX_2D, "__properties"}
    branch = {entities.of_vehicle(entity, "a-b") for entity in alone if entity not in shared}
    assert branch <= set(chunks(recording))


def test_positions_and_headings(sights, recording) -> None:
    found = chunks(recording)
    for member in members_of(sights):
        result = member.vehicle.reconstruction
        (at,) = values(found[member.place(entities.POSITION)], "InstancePoses3D:translations")
        assert at[0] == pytest.approx(result.location, abs=1e-5)
        (axes,) = values(found[member.place(entities.POSITION)], "Ellipsoids3D:half_sizes")
        assert axes[0] == pytest.approx([2.7955 * np.sqrt(1e-3)] * 3, rel=1e-4)
        (vector,) = values(found[member.place(entities.HEADING)], "Arrows3D:vectors")
        assert vector[0][0] > result.box_size[0] / 2
        (label,) = values(found[member.place(entities.HEADING)], "Arrows3D:labels")
        assert label == [member.title]


def test_states_tell_stage_status_and_side(recording) -> None:
    found = chunks(recording)
    (chunk,) = found[f"{entities.STATES}/third"]
    rows = chunk.to_record_batch().to_pydict()
    states = [state for (state,) in rows["StateChange:state"]]
    assert [state.partition(",")[0] for state in states] == ["initialisation", "pose", "ambiguous"]
    assert states[-1].endswith("rear" if states[1].endswith("front") else "front")
    assert rows[entities.STEP] == sorted(set(rows[entities.STEP]))
    assert rows[entities.STEP][-1] == 5
    (chunk,) = found[f"{entities.STATES}/a-b"]
    assert len(chunk.to_record_batch().to_pydict()[entities.STEP]) < 8  # changes, not steps


def test_the_layout_has_a_view_from_above_and_a_tab_for_each(recording) -> None:
    layout = layout_of(recording)
    assert layout.views["From above: box, heading, 95 % of position"] == 1
    assert layout.views["Stage, then status, and side"] == 1
    assert layout.views["Keypoints by weight"] == layout.views["Factor graph"] == len(TITLES)
    assert len(layout.eyes) == 2


def test_the_closest_model_is_shown_instead_of_the_surface(sights, example, tmp_path) -> None:
    result = example.reconstruction
    model = VehicleMesh("like it", result.shape.surface_vertices, result.shape.surface_faces)
    path = record_scene(tmp_path / "scene.rrd", [replace(sights[0], model=model), sights[1]])
    found = chunks(path)
    entity = entities.of_vehicle(entities.MODEL, "a-b")
    (vertices,) = values(found[entity], "Mesh3D:vertex_positions")
    assert np.asarray(vertices) == pytest.approx(result.shape.surface_vertices, abs=1e-5)
    assert entities.of_vehicle(entities.MODEL, "a-b-2") not in found
    surface = f"- /{entities.of_vehicle(entities.SURFACE, 'a-b')}/**"
    assert sum(surface in line for line in layout_of(path).contents) == 2
    assert sum("a-b-2/vehicle/surface" in line for line in layout_of(path).contents) == 1  # from above alone
    recording = record(tmp_path / "car.rrd", result, example.observation, example.camera, model=model)
    assert entities.MODEL in chunks(recording)
    assert any(f"- /{entities.SURFACE}/**" in line for line in layout_of(recording).contents)


def test_what_was_not_solved_is_in_it(sights, example, tmp_path) -> None:
    lost = replace(sights[1], reconstruction=failed(example))
    for order in ([lost, sights[0]], [lost]):
        read = replay.read(record_scene(tmp_path / "lost.rrd", order))
        assert read.vehicles["a-b"].history == ()
        assert read.vehicles["a-b"].log[-1].level == "ERROR"
    states = chunks(record_scene(tmp_path / "lost.rrd", [lost]))[f"{entities.STATES}/a-b"]
    assert values(states, "StateChange:state") == [["failed"]]
    with pytest.raises(InvalidInputError, match="vehicles"):
        record_scene(tmp_path / "none.rrd", [])


def test_ten_vehicles_take_less_than_five_megabytes(sights, example, tmp_path) -> None:
    many = [replace(sights[0], title=str(number)) for number in range(10)]
    path = record_scene(tmp_path / "many.rrd", many, ground=example.ground)
    assert path.stat().st_size < 5e6


def test_the_table_has_a_row_for_each(example) -> None:
    def of(result, detection=""):
        return SolvedVehicle(result, example.observation, example.camera, detection=detection)

    detected = scene_table([("a", of(example.reconstruction, "Van 0.87")), ("b", of(example.reconstruction))])
    assert detected.startswith("|  | detection | status |")
    assert detected.splitlines()[2].startswith("| a | Van 0.87 | converged | 2.50, 1.65, 9.00 |")
    assert detected.splitlines()[3].startswith("| b |  | converged |")
    table = scene_table([("a|b", of(example.reconstruction)), ("c", of(failed(example)))])
    assert table.splitlines()[2].startswith(r"| a\|b | converged | 2.50, 1.65, 9.00 |")
    assert table.splitlines()[3] == "| c | failed |"
