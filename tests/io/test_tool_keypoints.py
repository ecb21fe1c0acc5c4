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


def test_points_of_a_group_are_a_vehicle_and_hidden_ones_are_unsure(tmp_path):
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


def openlabel(*, visible=True):
    """As vcd writes it: boxes by their centres, objects by numbers as texts."""
    x1, y1, x2, y2 = BOX.tolist()
    points = [
        {"name": NAMES[i], "val": POINTS[i].tolist(), "attributes": {"boolean": [{"name": "visible", "val": visible}]}}
        for i in THERE
    ]
    box = {"name": "shape", "val": [(x1 + x2) / 2, (y1 + y2) / 2, x2 - x1, y2 - y1]}
    frame = {"objects": {"0": {"object_data": {"bbox": [box], "point2d": points}}, "1": {}}}
    streams = {"camera": {"description": "", "uri": "a/street.png", "type": "camera"}}
    objects = {"0": {"name": "7", "type": "Car"}, "1": {"name": "none", "type": "Van"}}
    return {"openlabel": {"frames": {"3": frame}, "objects": objects, "streams": streams}}


def scalabel(*, visible=True):
    nodes = [
        {"id": str(i), "category": NAMES[i], "location": POINTS[i].tolist(), "visibility": "V" if visible else "N"}
        for i in THERE
    ]
    box = dict(zip(("x1", "y1", "x2", "y2"), BOX.tolist(), strict=True))
    label = {"id": "7", "category": "Car", "box2d": box, "graph": {"nodes": nodes, "edges": []}}
    return {"frames": [{"name": "street.png", "labels": [label, {"id": "8", "box2d": None, "graph": None}]}]}


def datumaro(*, visible=True):
    x1, y1, x2, y2 = BOX.tolist()
    seen = [(2 if visible else 1) if i in THERE else 0 for i in range(len(NAMES))]
    values = np.nan_to_num(POINTS).ravel().tolist()
    points = {"type": "points", "label_id": 0, "group": 4, "points": values, "visibility": seen}
    box = {"type": "bbox", "label_id": 0, "group": 4, "bbox": [x1, y1, x2 - x1, y2 - y1]}
    of_points = {"items": [{"label_id": 0, "labels": list(NAMES)}]}
    categories = {"label": {"labels": [{"name": "Car"}]}, "points": of_points}
    return {"categories": categories, "items": [{"id": "street", "annotations": [points, box], **DATUMARO_IMAGE}]}


DATUMARO_IMAGE = {"image": {"path": "street.png", "size": [HEIGHT, WIDTH]}}


@pytest.mark.parametrize("made", [openlabel, scalabel, datumaro])
@pytest.mark.parametrize("visible", [True, False])
def test_a_vehicle_of_each_format_of_labels(tmp_path, made, visible):
    path = tmp_path / "labels.json"
    path.write_text(json.dumps(made(visible=visible)))
    (vehicle,) = read_any_keypoints(path, CATEGORY).instances
    check(vehicle, confidence=None if visible else vehicle.observation.confidence_midpoint)


def supervisely():
    """Whose points are whole pixels, as the tool rounds them."""
    nodes = {NAMES[i]: {"loc": POINTS[i].round().tolist()} for i in THERE}
    nodes |= {NAMES[i]: {"loc": [0, 0], "disabled": True} for i in MISSING}
    x1, y1, x2, y2 = BOX.tolist()
    graph = {"classTitle": "Car", "geometryType": "graph", "nodes": nodes, "instance": "k"}
    points = {"exterior": [[x2, y2], [x1, y1]], "interior": []}
    box = {"classTitle": "Car", "geometryType": "rectangle", "points": points, "instance": "k"}
    return {"size": {"width": WIDTH, "height": HEIGHT}, "objects": [graph, box]}


def test_a_graph_of_supervisely_has_the_box_of_its_instance():
    (vehicle,) = fgrecon.keypoints_from(supervisely())
    assert np.abs(vehicle.observation.keypoints[THERE] - POINTS[THERE].round()).max() == 0
    assert np.abs(vehicle.observation.box - BOX).max() < 1e-9
    assert np.flatnonzero(vehicle.observation.measured).tolist() == THERE


@pytest.mark.parametrize(
    ("made", "change", "message"),
    [
        (
            openlabel,
            lambda d: d["openlabel"]["frames"]["3"]["objects"]["0"]["object_data"]["point2d"][0].pop("val"),
            r"frames\.3\.objects\.0\.object_data\.point2d\.val",
        ),
        (
            openlabel,
            lambda d: d["openlabel"]["frames"]["3"]["objects"]["0"]["object_data"]["bbox"][0].update(val=[1]),
            r"object_data\.bbox\.val",
        ),
        (
            scalabel,
            lambda d: d["frames"][0]["labels"][0]["graph"]["nodes"][0].update(location="x"),
            r"frames\[0\]\.labels\[0\]\.graph\.nodes\[0\]\.location",
        ),
        (scalabel, lambda d: d["frames"][0]["labels"][0]["box2d"].pop("y1"), r"labels\[0\]\.box2d\.y1"),
        (datumaro, lambda d: d["items"][0]["annotations"][0].update(label_id=5), r"annotations\[0\]\.label_id"),
        (datumaro, lambda d: d["items"][0]["annotations"][0]["points"].pop(), r"annotations\[0\]\.points"),
        (supervisely, lambda d: d["objects"][0]["nodes"][NAMES[0]].update(loc=[1]), r"objects\[0\]\.nodes\."),
    ],
)
def test_what_is_malformed_in_labels_is_named(made, change, message):
    content = made()
    change(content)
    with pytest.raises(InvalidInputError, match=message):
        fgrecon.keypoints_from(content)


def test_predictions_that_nobody_has_accepted_are_named():
    (one,) = task()
    waiting = [{**one, "annotations": [], "predictions": one["annotations"]}]
    with pytest.raises(InvalidInputError, match=r"\[0\]\.annotations: got predictions alone.*Accept them"):
        fgrecon.keypoints_from(waiting)
    assert len(fgrecon.keypoints_from([*task(), *waiting])) == 1
