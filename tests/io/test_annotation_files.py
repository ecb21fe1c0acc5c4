"""Results as files of annotation tools, read back: `tests/formats/test_labels.py` has the tools' own libraries."""

import contextlib
import json
from dataclasses import replace
from xml.etree import ElementTree as ET

import numpy as np
import pytest

import fgrecon
from fgrecon.batch.inputs import sources_of
from fgrecon.batch.vehicle_tasks import read_tasks
from fgrecon.core.box3d import box_corners
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.geometry import transform
from fgrecon.io.cameras.camera_source import CameraSource
from fgrecon.io.export import ImageInfo, NamedResult, export
from fgrecon.io.export.image_info import image_box
from fgrecon.io.keypoints import parse_any_keypoints, read_any_keypoints
from tests.io.formats import CATEGORY
from tests.results import changed
from tests.viz.made_up import make_example


@pytest.fixture(scope="module")
def cars():
    made = [make_example(seed) for seed in range(2)]
    camera = replace(made[0].camera, image_size=made[0].camera.image_size or (1242, 375))
    return [
        NamedResult(name, one.reconstruction, image="street.png", camera=camera, kind=kind, score=0.75)
        for name, one, kind in zip("ab", made, ("Car", "Van"), strict=True)
    ]


def read_back(path):
    if path.name == "l.json":
        tasks = json.loads(path.read_text())
        for task in tasks:
            task["annotations"] = task.pop("predictions")  # what people accept of them
        return fgrecon.keypoints_from(tasks)
    return read_any_keypoints(path, CATEGORY).instances


ROUNDED = {"supervisely": 0.5001}


@pytest.mark.parametrize(
    ("name", "kind"),
    [
        ("c.xml", None),
        ("l.json", "label_studio"),
        *((f"{kind}.json", kind) for kind in ("scalabel", "labelme", "supervisely", "datumaro", "fiftyone")),
    ],
)
def test_keypoints_and_boxes_come_back(cars, tmp_path, name, kind):
    path = export(tmp_path / name, cars, kind)
    vehicles = read_back(path)
    assert [vehicle.kind for vehicle in vehicles] == ["Car", "Van"]
    assert {vehicle.image for vehicle in vehicles} == ({None} if kind == "supervisely" else {"street.png"})
    off = ROUNDED.get(kind, 1e-9)
    for vehicle, item in zip(vehicles, cars, strict=True):
        observation = vehicle.observation
        assert np.abs(observation.keypoints - item.result.pose.wireframe_uv).max() < off
        assert np.abs(observation.box - image_box(item)).max() < off
        if kind == "fiftyone":
            assert np.abs(observation.confidence - item.result.diagnostics.visibility).max() < 1e-9
        elif kind not in ("label_studio", "supervisely"):
            hidden = item.result.diagnostics.visibility < 0.5
            assert (observation.confidence < 1.0).tolist() == hidden.tolist()


def test_cuboids_of_cvat_are_the_pixels_of_the_corners(cars, tmp_path):
    root = ET.parse(export(tmp_path / "c.xml", cars, images={"street.png": ImageInfo(image_id=17)})).getroot()
    (image,) = root.iter("image")
    assert (image.get("id"), image.get("width")) == ("17", str(cars[0].camera.image_size[0]))
    cuboid = next(image.iter("cuboid"))
    corners = transform(cars[0].result.camera_T_object, box_corners(cars[0].result.box_size))
    length, width, height = cars[0].result.box_size
    for name, (along, up, left) in {"tl1": (1, 1, 1), "br1": (1, 0, -1), "bl2": (-1, 0, 1), "tr2": (-1, 1, -1)}.items():
        point = [along * length / 2, -up * height, left * width / 2]
        placed = transform(cars[0].result.camera_T_object, np.array([point]))
        assert np.abs(corners - placed).sum(axis=1).min() < 1e-9
        (wanted,) = cars[0].camera.project(placed)
        assert np.abs(np.array([float(cuboid.get(f"{axis}{name}")) for axis in "xy"]) - wanted).max() < 1e-9


def test_a_cuboid_behind_the_camera_and_a_size_that_is_not_known(cars, tmp_path):
    pose = cars[0].result.camera_T_object.copy()
    pose[2, 3] = 0.5
    near = replace(cars[0], result=changed(cars[0].result, camera_T_object=pose), box=np.array([0.0, 0.0, 9.0, 9.0]))
    root = ET.parse(export(tmp_path / "c.xml", [near])).getroot()
    assert [shape.tag for shape in root.find("image")] == ["skeleton", "box"]
    bare = [replace(cars[0], camera=None)]
    assert ET.parse(export(tmp_path / "c.xml", bare)).getroot().find("image").get("width") is None
    for kind in ("label_studio", "scalabel", "supervisely", "datumaro", "fiftyone"):
        with pytest.raises(InvalidInputError, match=r"image of unknown size, street\.png"):
            export(tmp_path / "x.json", bare, kind)


@pytest.mark.parametrize("kind", ["labelme", "supervisely"])
def test_vehicles_of_two_images_have_a_file_each(cars, tmp_path, kind):
    two = [cars[0], replace(cars[1], image="other.png")]
    with pytest.raises(InvalidInputError, match=r"vehicles of 2 images.*Write a file for each"):
        export(tmp_path / "x.json", two, kind)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda sample: sample.pop("metadata"), r"samples\[0\]\.metadata\.width: got nothing"),
        (lambda sample: sample["keypoints"]["keypoints"][0]["names"].pop(), r"keypoints\[0\]\.names: got 13 and 14"),
        (
            lambda sample: sample["detections"]["detections"][0].update(bounding_box=[1, 2]),
            r"detections\[0\]\.bounding_box: got 2 elements",
        ),
    ],
)
def test_a_malformed_sample_of_fiftyone_is_named(cars, tmp_path, change, message):
    path = export(tmp_path / "x.json", cars[:1], "fiftyone")
    data = json.loads(path.read_text())
    change(data["samples"][0])
    path.write_text(json.dumps(data))
    with pytest.raises(InvalidInputError, match=message):
        read_any_keypoints(path, CATEGORY)


def test_points_that_fiftyone_has_as_nan_are_not_there(cars, tmp_path):
    path = export(tmp_path / "x.json", cars[:1], "fiftyone")
    data = json.loads(path.read_text())
    data["samples"][0]["keypoints"]["keypoints"][0]["points"][3] = [float("nan")] * 2
    path.write_text(json.dumps(data))
    (vehicle,) = read_any_keypoints(path, CATEGORY).instances
    assert np.flatnonzero(~vehicle.observation.measured).tolist() == [3]


@pytest.mark.parametrize("kind", ["scalabel", "labelme", "supervisely", "datumaro", "fiftyone"])
def test_batches_and_reconstruct_take_what_was_exported(cars, tmp_path, kind):
    path = export(tmp_path / "x.json", cars, kind)
    (source,) = sources_of([path])
    assert len(list(source.rows())) == len(cars)
    tasks = read_tasks(path, CATEGORY, CameraSource(intrinsics=[721.5, 721.5, 609.6, 172.9])).tasks
    assert [task.instance.kind for task in tasks] == ["Car", "Van"]


def _places(data, way=()):
    """The ways to all values of a file, of lists to the first alone."""
    items = data.items() if isinstance(data, dict) else enumerate(data[:1]) if isinstance(data, list) else ()
    for key, value in items:
        yield (*way, key)
        yield from _places(value, (*way, key))


@pytest.mark.parametrize("kind", ["label_studio", "scalabel", "labelme", "supervisely", "datumaro", "fiftyone"])
def test_whatever_value_is_replaced_is_read_or_refused_by_name(cars, tmp_path, kind):
    text = export(tmp_path / "x.json", cars[:1], kind).read_text()
    for way in _places(json.loads(text)):
        for value in (None, "x", [], {}, 5, True, [[1]], -1.5):
            data = json.loads(text)
            inside = data
            for key in way[:-1]:
                inside = inside[key]
            inside[way[-1]] = value
            with contextlib.suppress(InvalidInputError):
                parse_any_keypoints(data, CATEGORY)
