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
    said = devkit("datumaro", "datumaro_reads", folder)
    assert np.abs(np.array(said["boxes"]) - [image_box(item) for item in cars]).max() < 0.02
    pixels = np.concatenate([item.result.pose.wireframe_uv for item in cars])
    assert np.abs(np.array(said["points"]) - pixels).max() < 0.02


def test_label_studio_takes_tasks(tmp_path, devkit, cars):  # noqa: F811
    path = export(tmp_path / "l.json", cars, "label_studio")
    said = devkit("label_studio", "label_studio_reads", path, ",".join(keypoint_names(cars[0])), "Car,Van")
    assert said == [[True]]
