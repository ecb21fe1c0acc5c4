"""Keypoints of annotation tools' own files: Label Studio, labelme, CVAT."""

import json

import numpy as np
import pytest

import fgrecon
from fgrecon.batch.inputs import sources_of
from fgrecon.core.errors import InvalidInputError
from fgrecon.io.keypoints import read_any_keypoints

from .formats import CATEGORY, MISSING, car

POINTS, BOX = car()
NAMES = CATEGORY.keypoints
THERE = [i for i in range(len(NAMES)) if i not in MISSING]
WIDTH, HEIGHT = 1242, 375


def region(kind, name, value, number, parent=None):
    size = {"original_width": WIDTH, "original_height": HEIGHT, "image_rotation": 0}
    return {"id": number, "type": kind, "value": {**value, kind: [name]}, "parentID": parent, **size}


def hundredths(u, v):
    return {"x": 100.0 * u / WIDTH, "y": 100.0 * v / HEIGHT}


def task(rotation=0.0, parent="r1"):
    x1, y1, x2, y2 = BOX.tolist()
    extent = {"width": 100.0 * (x2 - x1) / WIDTH, "height": 100.0 * (y2 - y1) / HEIGHT, "rotation": rotation}
    regions = [region("rectanglelabels", "Car", hundredths(x1, y1) | extent, "r1")]
    for i in THERE:
        point = hundredths(*POINTS[i].tolist()) | {"width": 0.5}
        regions.append(region("keypointlabels", NAMES[i], point, f"k{i}", parent))
    return [{"id": 5, "data": {"image": "/data/upload/street.png?x=1"}, "annotations": [{"id": 1, "result": regions}]}]


def labelme(group=3):
    shapes = [
        {"label": NAMES[i], "points": [POINTS[i].tolist()], "group_id": group, "shape_type": "point", "flags": {}}
        for i in THERE
    ]
    x1, y1, x2, y2 = BOX.tolist()  # drawn from the lower right corner
    box = {"label": "Car", "points": [[x2, y2], [x1, y1]], "group_id": group, "shape_type": "rectangle", "flags": {}}
    rest = {"version": "7.9.1", "imageData": None, "imageHeight": HEIGHT, "imageWidth": WIDTH, "flags": {}}
    return {"shapes": [*shapes, box], "imagePath": "..\\images\\street.png", **rest}


def cvat(*, skeleton, occluded=0):
    flags = f'occluded="{occluded}"'
    points = "".join(
        f'<points label="{NAMES[i]}" outside="0" {flags} points="{POINTS[i][0]},{POINTS[i][1]}" group_id="4"></points>'
        for i in THERE
    )
    gone = f'<points label="{NAMES[MISSING[0]]}" outside="1" {flags} points="0,0" group_id="4"></points>'
    corners = " ".join(f'{n}="{v}"' for n, v in zip(("xtl", "ytl", "xbr", "ybr"), BOX.tolist(), strict=True))
    shapes = f'<skeleton label="Car" group_id="4">{points}{gone}</skeleton>' if skeleton else points + gone
    box = f'<box label="Car" {flags} {corners} group_id="4"></box>'
    image = f'<image id="0" name="a/street.png" width="{WIDTH}" height="{HEIGHT}">{shapes}{box}</image>'
    return f'<?xml version="1.0" encoding="utf-8"?><annotations><version>1.1</version>{image}</annotations>'


def check(vehicle, *, kind="Car", box=BOX, confidence=None):
    observation = vehicle.observation
    assert np.flatnonzero(observation.measured).tolist() == THERE
    assert np.abs(observation.keypoints[THERE] - POINTS[THERE]).max() < 1e-9
    assert np.abs(observation.box - box).max() < 1e-9
    assert (vehicle.kind, vehicle.image) == (kind, "street.png")
    if confidence is not None:
        assert np.allclose(observation.confidence[THERE], confidence)


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("tasks.json", json.dumps(task())),
        ("tasks.json", json.dumps(task(parent=None))),
        ("street.json", json.dumps(labelme())),
        ("street.json", json.dumps(labelme(None))),
        ("annotations.xml", cvat(skeleton=True)),
    ],
)
def test_a_vehicle_of_each_tool(tmp_path, name, content):
    path = tmp_path / name
    path.write_text(content)
    (vehicle,) = read_any_keypoints(path, CATEGORY).instances
    check(vehicle)
    (source,) = sources_of([path])
    (row,) = source.rows()
    check(fgrecon.keypoints_from(json.loads(row["instance"]))[0])


def test_points_of_a_group_are_a_vehicle_and_hidden_ones_are_doubtful(tmp_path):
    path = tmp_path / "annotations.xml"
    path.write_text(cvat(skeleton=False, occluded=1))
    (vehicle,) = read_any_keypoints(path, CATEGORY).instances
    check(vehicle, kind=None, confidence=vehicle.observation.confidence_midpoint)


def test_a_rectangle_that_is_turned_becomes_the_one_around_it():
    (vehicle,) = fgrecon.keypoints_from(task(rotation=90.0))
    x1, y1, x2, y2 = BOX.tolist()
    check(vehicle, box=[x1 - (y2 - y1), y1, x1, y1 + (x2 - x1)])  # about its upper left corner, clockwise


def test_what_is_malformed_is_named(tmp_path):
    bad = task()
    bad[0]["annotations"][0]["result"][1]["value"]["x"] = "left"
    with pytest.raises(InvalidInputError, match=r"annotations\[0\]\.k\d+\.value\.x"):
        fgrecon.keypoints_from(bad)
    bad = labelme()
    bad["shapes"][0]["points"] = [[1.0]]
    with pytest.raises(InvalidInputError, match=r"shapes\[0\]\.points"):
        fgrecon.keypoints_from(bad)
    path = tmp_path / "a.xml"
    for text, message in (
        (cvat(skeleton=True).replace('points="', 'points="x', 1), "image a/street.png"),
        ("<annotation></annotation>", "CVAT's XML for images"),
        ("<annotations>", "XML file of CVAT"),
    ):
        path.write_text(text)
        with pytest.raises(InvalidInputError, match=message):
            read_any_keypoints(path, CATEGORY)
