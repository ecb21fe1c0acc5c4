"""Files for other programs read back with those programs' readers, and hold the result."""

from __future__ import annotations

import csv
import io
import json
from dataclasses import replace

import numpy as np
import pytest

from fgrecon.core.errors import InvalidInputError
from fgrecon.core.reconstruction import Status
from fgrecon.io.export import FORMATS, NamedResult, export, read_results
from fgrecon.io.export.dataset_results import kitti_text
from fgrecon.io.export.formats import export_rows
from fgrecon_research.io.kitti_sets import parse_objects
from tests.results import changed
from tests.viz.made_up import make_example


@pytest.fixture(scope="module")
def cars():
    """Two cars, one of them with all that a track knows."""
    first, second = make_example(0), make_example(1)
    offset = np.array([0.06, -0.01, 0.0])
    return [
        NamedResult("near", first.reconstruction, first.observation.box, offset),
        NamedResult("far", second.reconstruction),
    ]


@pytest.fixture(scope="module")
def refused(cars):
    """A result without a pose."""
    result = changed(cars[0].result, status=Status.FAILED, camera_T_object=np.full((4, 4), np.nan))
    return NamedResult("refused", result)


def in_camera(result, points):
    return points @ result.camera_T_object[:3, :3].T + result.camera_T_object[:3, 3]


def test_ply_has_every_surface_in_the_camera_frame(cars, refused, tmp_path):
    import trimesh

    mesh = trimesh.load(export(tmp_path / "cars.ply", [*cars, refused]), process=False)
    for car in cars:
        expected = in_camera(car.result, car.result.shape.surface_vertices)
        start = np.flatnonzero(np.abs(mesh.vertices - expected[0]).max(axis=1) < 1e-5)[0]
        np.testing.assert_allclose(mesh.vertices[start : start + len(expected)], expected, atol=1e-5)
        for point in in_camera(car.result, car.result.wireframe):  # a ball lies around every keypoint
            near = np.linalg.norm(mesh.vertices - point, axis=1)
            assert (np.abs(near - 0.03) < 1e-3).sum() >= 12
    colours = {tuple(colour[:3]) for colour in mesh.visual.vertex_colors}
    assert {(0, 114, 178), (213, 94, 0)} <= colours


def test_glb_has_named_nodes_that_stand_upright(cars, tmp_path):
    import trimesh

    scene = trimesh.load(export(tmp_path / "cars.glb", cars))
    assert {f"{car.name}/{part}" for car in cars for part in ("surface", "wireframe")} <= set(scene.geometry)
    result = cars[0].result
    turned = scene.graph.get("near/surface")[0]
    drawn = trimesh.transform_points(scene.geometry["near/surface"].vertices, turned)
    expected = in_camera(result, result.shape.surface_vertices) * (1, -1, -1)
    np.testing.assert_allclose(sorted(drawn[:, 1]), sorted(expected[:, 1]), atol=1e-5)


def test_parts_of_a_glb_are_no_metal(cars, tmp_path):
    """Metal, the default, is black in viewers that have nothing around to mirror."""
    content = export(tmp_path / "cars.glb", cars).read_bytes()
    tree = json.loads(content[20 : 20 + int.from_bytes(content[12:16], "little")])
    assert tree["materials"][0]["pbrMetallicRoughness"]["metallicFactor"] == 0.0
    assert {p["material"] for mesh in tree["meshes"] for p in mesh["primitives"]} == {0}


def test_glb_has_every_vehicle_of_an_id(cars, tmp_path):
    import trimesh

    scene = trimesh.load(export(tmp_path / "cars.glb", [replace(car, name="a") for car in cars]))
    assert sorted(scene.graph.nodes_geometry) == ["a-2/surface", "a-2/wireframe", "a/surface", "a/wireframe"]


def test_csv_numbers_read_back_to_the_last_bit(cars, refused, tmp_path):
    text = export(tmp_path / "cars.csv", [*cars, refused]).read_text()
    rows = list(csv.DictReader(io.StringIO(text)))
    assert [row["id"] for row in rows] == ["near", "far", "refused"]
    for row, car in zip(rows, cars, strict=False):
        result = car.result
        assert float(row["rotation_y"]) == result.rotation_y
        assert [float(row[axis]) for axis in "xyz"] == result.location.tolist()
        assert float(row["lambda_2"]) == result.shape.coefficients[1]
        assert float(row["left_front_roof_v"]) == result.pose.wireframe_uv[10, 1]
        assert float(row["right_back_wheel_weight"]) == result.diagnostics.weights[3]
        assert float(row["sigma_translation"]) == pytest.approx(np.sqrt(1e-3))
    assert np.isnan(float(rows[2]["x"]))
    assert rows[2]["status"] == "failed"


def test_csv_ids_with_any_line_end_are_one_cell(cars, tmp_path):
    ids = ["a\rb", "a\nb", "a\r\nb", 'a"b', "a,b"]
    path = export(tmp_path / "cars.csv", [replace(cars[0], name=name) for name in ids])
    with path.open(newline="") as file:
        assert [row["id"] for row in csv.DictReader(file)] == ids
    assert b"\r\n" not in path.read_bytes().replace(b'"a\r\nb"', b"")


def test_csv_of_different_priors_is_refused(cars, tmp_path):
    other = NamedResult("other", changed(cars[1].result, coefficients=np.zeros(3)))
    with pytest.raises(InvalidInputError, match="different priors"):
        export(tmp_path / "mixed.csv", [cars[0], other])
    assert not list(tmp_path.iterdir())


def test_parquet_has_arrays_as_lists(cars, tmp_path):
    import pyarrow.parquet as pq

    undetermined = NamedResult("undetermined", changed(cars[1].result, pose_covariance=None))
    rows = pq.read_table(export(tmp_path / "cars.parquet", [*cars, undetermined])).to_pylist()
    for row, car in zip(rows, cars, strict=False):
        assert row["camera_T_object"] == car.result.camera_T_object.ravel().tolist()
        assert np.array_equal(np.reshape(row["wireframe"], (-1, 3)), car.result.wireframe)
        assert row["keypoints"] == list(car.result.shape.keypoint_names)
    assert rows[2]["sigma_rotation"] is None


@pytest.mark.parametrize("kind", ["csv", "parquet", "vision_msgs"])
def test_ids_that_are_no_text_are_written_with_replacement_characters(cars, tmp_path, kind):
    if kind == "vision_msgs":
        pytest.importorskip("mcap_ros2", reason="mcap-ros2-support is not installed")
    path = tmp_path / f"cars.{kind if kind in FORMATS else 'mcap'}"
    assert export(path, [replace(cars[0], name="n\udcff")], kind).stat().st_size > 0
    if kind == "csv":
        assert next(csv.DictReader(io.StringIO(path.read_text("utf-8"))))["id"] == "n\ufffd"


def test_kitti_lines_are_in_the_label_frame(cars, refused, tmp_path):
    text = export(tmp_path / "000000.txt", [*cars, refused]).read_text()
    objects, problems = parse_objects(text, "000000.txt", scored=True)
    assert problems == []
    assert objects.kind == ("Car", "Car")
    near, far = (car.result for car in cars)
    np.testing.assert_allclose(objects.location[0], near.location - cars[0].label_offset, atol=1e-4)
    np.testing.assert_allclose(objects.location[1], far.location, atol=1e-4)
    np.testing.assert_allclose(objects.box[0], cars[0].box, atol=1e-2)
    np.testing.assert_allclose(objects.box[1][:2], far.pose.wireframe_uv.min(axis=0), atol=1e-2)
    np.testing.assert_allclose(objects.size, [near.box_size, far.box_size], atol=1e-4)
    np.testing.assert_allclose(objects.rotation_y, [near.rotation_y, far.rotation_y], atol=1e-4)
    x, _, z = objects.location.T
    np.testing.assert_allclose(np.cos(objects.alpha), np.cos(objects.rotation_y - np.arctan2(x, z)), atol=1e-3)
    assert ((objects.score > 0) & (objects.score <= 1)).all()


def boxed(result, camera):
    """The box that KITTI's line of a result has."""
    objects, _ = parse_objects(kitti_text([NamedResult("a", result, camera=camera)]), "a", scored=True)
    return objects.box[0]


def test_a_box_is_that_of_the_surface_cut_at_the_image(cars):
    """Not of the keypoints, which are inside of the outline and may be beyond the image."""
    result, camera = cars[0].result, replace(make_example(0).camera, image_size=None)
    ahead = in_camera(result, result.shape.surface_vertices)
    pixels = camera.project(ahead)
    np.testing.assert_allclose(boxed(result, camera), [*pixels.min(axis=0), *pixels.max(axis=0)], atol=1e-2)
    middle = int(pixels[:, 0].mean()) + 1
    cut = boxed(result, replace(camera, image_size=(middle, 1000)))
    assert cut[2] == middle - 1
    assert cut[0] == pytest.approx(pixels[:, 0].min(), abs=1e-2)


def test_a_box_of_a_car_that_the_camera_is_beside_ends_at_the_near_plane(cars):
    result, camera = cars[0].result, replace(make_example(0).camera, image_size=(1242, 375))
    pose = np.array(result.camera_T_object)
    surface = result.shape.surface_vertices @ pose[:3, :3].T
    behind = 1.0 - surface[:, 2].min() - 2.0  # it begins 1 m behind the camera, half a metre to the left
    pose[:3, 3] = [-0.5 - surface[:, 0].min(), 1.6, behind]
    box = boxed(changed(result, camera_T_object=pose), camera)
    assert box[2] == 1241
    assert 0 <= box[0] < 1241
    assert box[3] == 374


def test_kittis_file_is_of_one_image(cars, refused, tmp_path):
    """Each of KITTI's files is of one image, whose cars all of its lines are taken for."""
    several = [replace(car, image=name) for car, name in zip(cars, "ab", strict=True)]
    with pytest.raises(InvalidInputError, match=r"results: got vehicles of 2 images. Write a file for each"):
        export(tmp_path / "several.txt", several)
    assert not list(tmp_path.iterdir())
    for name in "ab":
        found = export(tmp_path / f"{name}.txt", [car for car in several if car.image == name]).read_text()
        assert found.count("\n") == 1
    export(tmp_path / "rest.txt", [several[0], replace(refused, image="b")])
    export(tmp_path / "rows.txt", [replace(car, row=car.name) for car in cars])  # whose images are not given


@pytest.mark.parametrize("kind", FORMATS)
def test_nothing_to_write_is_refused(kind, refused, tmp_path):
    with pytest.raises(InvalidInputError, match="results"):
        export(tmp_path / f"none.{kind}", [])
    if kind in ("ply", "glb"):
        with pytest.raises(InvalidInputError, match="pose"):
            export(tmp_path / f"none.{kind}", [refused])
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", ["cars", "cars.obj"])
def test_other_endings_are_refused(cars, tmp_path, name):
    with pytest.raises(InvalidInputError, match="ply, glb, csv, parquet, txt"):
        export(tmp_path / name, cars)


def test_rows_of_any_kind_as_tables(tmp_path):
    parquet = pytest.importorskip("pyarrow.parquet")
    rows = [{"name": "a", "metres": 0.1}, {"name": "b, c", "metres": None}]
    assert export_rows(tmp_path / "r.csv", rows).read_text() == 'name,metres\na,0.1\n"b, c",\n'
    assert parquet.read_table(export_rows(tmp_path / "r.parquet", rows)).to_pylist() == rows
    with pytest.raises(InvalidInputError, match="csv, parquet"):
        export_rows(tmp_path / "r.ply", rows)
    with pytest.raises(InvalidInputError, match="rows"):
        export_rows(tmp_path / "none.csv", [])
    assert len(list(tmp_path.iterdir())) == 2


def test_results_are_read_from_every_file_that_fgrecon_writes(cars, tmp_path):
    result = cars[0].result.to_dict()
    located = (cars[0].result.location - (0.06, 0.0, 0.0)).tolist()
    entry = {"id": "a", "box": [1, 2, 30, 40], "location_in_label_frame": located, "result": result}
    contents = {
        "one.json": result,
        "demo.json": {"format": "fgrecon.demo/1", "result": result},
        "many.json": {"format": "fgrecon.reconstructions/1", "instances": [entry, {"id": "b", "result": None}]},
    }
    for name, content in contents.items():
        (tmp_path / name).write_text(json.dumps(content))
        (found,) = read_results(tmp_path / name)
        assert np.array_equal(found.result.camera_T_object, cars[0].result.camera_T_object)
    assert found.box.tolist() == [1, 2, 30, 40]
    np.testing.assert_allclose(found.label_offset, (0.06, 0.0, 0.0), atol=1e-12)


@pytest.mark.parametrize(
    "content",
    ["[]", '{"format": "other"}', '{"format": "fgrecon.demo/1"}', '{"format": "fgrecon.reconstructions/1"}', "{"],
)
def test_other_files_are_refused(tmp_path, content):
    (tmp_path / "x.json").write_text(content)
    with pytest.raises(InvalidInputError, match=r"x\.json"):
        read_results(tmp_path / "x.json")
