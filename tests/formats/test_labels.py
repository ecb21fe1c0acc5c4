"""Labels of annotation tools by their own libraries: what they write is read, and what is exported they read."""

import json

import cv2
import numpy as np
import pytest

from fgrecon.core.box3d import box_corners
from fgrecon.core.geometry import transform
from fgrecon.io.export import export
from fgrecon.io.export.image_info import image_box, keypoint_names
from fgrecon.io.keypoints import read_any_keypoints
from tests.io.formats import CATEGORY
from tests.io.test_annotation_files import cars  # noqa: F401 - a fixture
from tests.io.test_tool_keypoints import BOX, NAMES, POINTS, THERE

pytestmark = pytest.mark.formats

GIVEN = json.dumps({"box": BOX.tolist(), "points": {NAMES[i]: POINTS[i].tolist() for i in THERE}})


@pytest.mark.parametrize(
    ("tool", "off"),
    [("scalabel", 1e-9), ("openlabel", 1e-9), ("supervisely", 0.5001), ("datumaro", 0.0051)],  # two round
)
def test_what_a_tool_writes_is_read(tmp_path, devkit, tool, off):
    path = tmp_path / "labels.json"
    devkit(tool, f"{tool}_writes", tmp_path / "out" if tool == "datumaro" else path, given=GIVEN)
    if tool == "datumaro":
        (path,) = (tmp_path / "out").rglob("*.json")
    (vehicle,) = read_any_keypoints(path, CATEGORY).instances
    observation = vehicle.observation
    assert np.flatnonzero(observation.measured).tolist() == THERE
    assert np.abs(observation.keypoints[THERE] - POINTS[THERE]).max() < 2 * off
    assert np.abs(observation.box - BOX).max() < 2 * off
    assert vehicle.kind == ("carbox" if tool == "supervisely" else "car")


def test_scalabel_reads_boxes_points_and_corners(tmp_path, devkit, cars):  # noqa: F811
    (frame,) = devkit("scalabel", "scalabel_reads", export(tmp_path / "s.json", cars, "scalabel"))
    assert frame["image"] == "street.png"
    for number, item in enumerate(cars):
        result = item.result
        assert np.abs(image_box(item) - frame["boxes"][number]).max() < 1e-9
        points = np.array([frame["points"][number][name] for name in keypoint_names(item)])
        assert np.abs(points - result.pose.wireframe_uv).max() < 1e-9
        ours = transform(result.camera_T_object, box_corners(result.box_size))
        theirs = np.array(frame["corners"][number])[:, None]
        assert np.linalg.norm(theirs - ours, axis=2).min(axis=0).max() < 1e-6
        front = theirs[4:, 0].mean(axis=0)  # its v1..
        assert np.abs(front - ours[4:].mean(axis=0)).max() < 1e-6


def test_datumaro_reads_boxes_and_points_of_cvat(tmp_path, devkit, cars):  # noqa: F811
    folder = tmp_path / "cvat"
    (folder / "images").mkdir(parents=True)
    width, height = cars[0].camera.image_size
    cv2.imwrite(str(folder / "images" / "street.png"), np.zeros((height, width, 3), np.uint8))
    export(folder / "c.xml", cars)
    said = devkit("datumaro", "datumaro_reads", folder, "cvat")
    assert np.abs(np.array(said["boxes"]) - [image_box(item) for item in cars]).max() < 0.02
    pixels = np.concatenate([item.result.pose.wireframe_uv for item in cars])
    assert np.abs(np.array(said["points"]) - pixels).max() < 0.02


def test_datumaro_reads_its_own_file(tmp_path, devkit, cars):  # noqa: F811
    (tmp_path / "annotations").mkdir()
    export(tmp_path / "annotations" / "default.json", cars, "datumaro")
    said = devkit("datumaro", "datumaro_reads", tmp_path, "datumaro")
    assert np.abs(np.array(said["boxes"]) - [image_box(item) for item in cars]).max() < 0.02
    pixels = [item.result.pose.wireframe_uv.ravel() for item in cars]
    assert np.abs(np.array(said["points"]) - pixels).max() < 0.0051  # it rounds
    assert said["groups"] == [1, 1, 1, 2, 2, 2]
    for item, cuboid in zip(cars, said["cuboids"], strict=True):
        top, bottom = np.array(cuboid[:4]), np.array(cuboid[4:])
        assert (top[:, 1] < bottom[:, 1]).all()
        assert np.abs(np.array(cuboid) - _corners(item)[[7, 6, 2, 3, 5, 4, 0, 1]]).max() < 1e-9


def _corners(item):
    """(8, 2) pixels of a box's corners: rear before front, bottom before top, right before left."""
    return item.camera.project(transform(item.result.camera_T_object, box_corners(item.result.box_size)))


def test_labelme_opens_its_file(tmp_path, devkit, cars):  # noqa: F811
    width, height = cars[0].camera.image_size
    cv2.imwrite(str(tmp_path / "street.png"), np.zeros((height, width, 3), np.uint8))
    said = devkit("labelme", "labelme_reads", export(tmp_path / "street.json", cars, "labelme"))
    assert said["image"] == "street.png"
    for group, item in enumerate(cars):
        box, *points = (one for one in said["shapes"] if one["group_id"] == group)
        assert (box["label"], box["shape_type"]) == (item.kind, "rectangle")
        assert np.abs(np.ravel(box["points"]) - image_box(item)).max() < 1e-9
        assert [one["label"] for one in points] == list(keypoint_names(item))
        assert np.abs([one["points"][0] for one in points] - item.result.pose.wireframe_uv).max() < 1e-9
        hidden = item.result.diagnostics.visibility < 0.5
        assert [one["flags"]["hidden"] for one in points] == hidden.tolist()


def test_supervisely_opens_its_annotation(tmp_path, devkit, cars):  # noqa: F811
    path = export(tmp_path / "street.json", cars, "supervisely")
    names = json.dumps(keypoint_names(cars[0]))
    said = devkit("supervisely", "supervisely_reads", path, "Car,Van", given=names)
    assert said["size"] == list(cars[0].camera.image_size[::-1])
    for item, box, graph in zip(cars, said["boxes"], said["points"], strict=True):
        assert (box["kind"], graph["kind"]) == (f"{item.kind} box", item.kind)
        assert box["instance"] == graph["instance"]
        assert np.abs(np.array(box["box"]) - image_box(item)).max() <= 0.5
        points = np.array([graph["points"][name] for name in keypoint_names(item)])
        assert np.abs(points - item.result.pose.wireframe_uv).max() <= 0.5


def test_fiftyone_takes_samples(tmp_path, devkit, cars):  # noqa: F811
    path = export(tmp_path / "samples.json", cars, "fiftyone")
    size = np.array(cars[0].camera.image_size)
    given = [_corners(item)[[5, 4, 6, 7, 1, 0, 2, 3]].tolist() for item in cars]
    (said,) = devkit("fiftyone", "fiftyone_reads", path, given=json.dumps(given))
    for number, item in enumerate(cars):
        label, index, confidence, (x, y, width, height) = said["boxes"][number]
        assert (label, index, confidence) == (item.kind, number, 0.75)
        assert np.abs(np.array([x, y, x + width, y + height]) * np.tile(size, 2) - image_box(item)).max() < 1e-9
        label, index, points, confidence, names = said["points"][number]
        assert (label, index, names) == (item.kind, number, list(keypoint_names(item)))
        assert np.abs(np.array(points) * size - item.result.pose.wireframe_uv).max() < 1e-9
        assert confidence == item.result.diagnostics.visibility.tolist()
        for ours, theirs in zip(said["cuboids"][number], said["theirs"][number], strict=True):
            assert np.abs(np.sort(ours, axis=0) - np.sort(theirs, axis=0)).max() < 1e-12


def test_label_studio_takes_tasks(tmp_path, devkit, cars):  # noqa: F811
    path = export(tmp_path / "l.json", cars, "label_studio")
    said = devkit("label_studio", "label_studio_reads", path, ",".join(keypoint_names(cars[0])), "Car,Van")
    assert said == [[True]]
