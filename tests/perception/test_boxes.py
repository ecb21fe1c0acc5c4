"""Boxes from the command line and from files."""

import json

import numpy as np
import pytest

from fgrecon.core.errors import InvalidInputError
from fgrecon.core.options import BoxModel, BoxOptions, Options
from fgrecon.io.boxes import boxes_in
from fgrecon.perception import boxes as module
from fgrecon.perception.boxes import GivenBoxes, detected_boxes, for_detected
from fgrecon.perception.vehicles import Vehicles

PIXELS = np.zeros((100, 100, 3), np.uint8)
LABEL = "0.00 0 1.5 10.0 20.0 30.0 40.0 1.5 1.6 4.0 1 2 20 1.5"


def read_boxes(file, image, *how, **more):
    """The cars alone."""
    return boxes_in(file, image, *how, **more).cars


def test_given_boxes_are_outlines(tmp_path):
    (box,) = GivenBoxes([[1, 2, 30, 40]]).of_image(tmp_path / "a.png", PIXELS).cars
    assert (box.name, box.model) == ("0", BoxModel.SURFACE)
    np.testing.assert_array_equal(box.corners, [1, 2, 30, 40])


def test_either_boxes_or_a_file(tmp_path):
    for ways in ({"detect": True}, {"given": [[1, 2, 3, 4]]}):
        with pytest.raises(InvalidInputError, match="box"):
            GivenBoxes(file=tmp_path / "b.txt", **ways)


def test_detected_cars_are_outlines_and_large_enough_for_keypoints(monkeypatch):
    boxes = np.array([[10.0, 10, 90, 60], [5, 5, 12, 10], [0, 0, 8, 6]])
    monkeypatch.setattr(module, "NanodetVehicleDetector", lambda: lambda image: Vehicles(boxes, np.ones(3)))
    found = detected_boxes(np.zeros((100, 100, 3), np.uint8))
    assert [(box.name, box.model) for box in found] == [("0", BoxModel.DETECTED), ("1", BoxModel.DETECTED)]
    np.testing.assert_array_equal([box.corners for box in found], boxes[[0, 2]])


def test_only_outlines_become_those_of_the_packages_detector():
    assert for_detected(None).box.model is BoxModel.DETECTED
    given = Options(box=BoxOptions(sigma_pixels=3.0), ambiguity_margin=5.0)
    assert for_detected(given) == Options(box=BoxOptions(BoxModel.DETECTED, sigma_pixels=3.0), ambiguity_margin=5.0)
    cuboid = Options(box="cuboid")
    assert for_detected(cuboid) is cuboid


def test_boxes_of_low_score_are_left_out_where_asked(tmp_path, monkeypatch):
    """A file's scores end at 1 and count from 0.5, but for KITTI's results, which are of any scale."""
    kitti, coco, yolo, detections = (tmp_path / name for name in ("a.txt", "a.json", "y.txt", "d.txt"))
    kitti.write_text(f"Car {LABEL}\nCar {LABEL} 0.2\nCar {LABEL} 7.5\n")
    entry = {"image_id": "a", "category_id": 3, "bbox": [10, 20, 30, 40]}
    coco.write_text(json.dumps([entry, *({**entry, "score": score} for score in (0.2, 0.6, 0.9))]))
    yolo.write_text("".join(f"2 0.5 0.5 0.2 0.2 {score}\n" for score in (0.2, 0.6, 0.9)))
    detections.write_text("".join(f"a.png 2 {score} 1 2 3 4\n" for score in (0.2, 0.6, 0.9)))
    for file, counts in ((kitti, (3, 3, 2)), (coco, (3, 4, 2)), (yolo, (2, 3, 1)), (detections, (2, 3, 1))):
        for least, count in zip((None, 0.1, 0.7), counts, strict=True):
            assert len(GivenBoxes(file=file, least_score=least).of_image(tmp_path / "a.png", PIXELS).cars) == count
    asked = []
    found = Vehicles(np.array([[10.0, 10, 90, 60]]), np.ones(1))
    monkeypatch.setattr(
        module, "NanodetVehicleDetector", lambda: lambda image, least_score=None: asked.append(least_score) or found
    )
    for least in (None, 0.3):
        GivenBoxes(least_score=least).of_image(tmp_path / "a.png", PIXELS)
    assert asked == [None, 0.3]


def test_labels_keep_their_line_as_name(tmp_path):
    file = tmp_path / "000010.txt"
    file.write_text(f"Van {LABEL}\nCar {LABEL}\n\nDontCare {LABEL}\nCar {LABEL} 0.9\n")
    found = read_boxes(file, "000010")
    assert [(box.name, box.model) for box in found] == [("1", BoxModel.CUBOID), ("4", BoxModel.CUBOID)]
    np.testing.assert_array_equal(found[0].corners, [10, 20, 30, 40])


def test_detections_of_the_image_alone(tmp_path):
    file = tmp_path / "d.txt"
    lines = ["x/000003.png 2 0.9 1 2 3 4", "x/000003.png 1 0.9 1 2 3 4", "x/000003.png 2 0.1 1 2 3 4"]
    file.write_text("\n".join([*lines, "x/000004.png 2 0.9 5 6 7 8"]))
    assert [box.corners.tolist() for box in read_boxes(file, "000003")] == [[1, 2, 3, 4]]
    with pytest.raises(InvalidInputError, match="car in image 000009"):
        GivenBoxes(file=file).of_image(tmp_path / "000009.png", PIXELS)


def test_detections_of_an_image_whose_name_has_spaces_and_of_unknown_classes(tmp_path):
    file = tmp_path / "d.txt"
    file.write_text("my street.png 2 0.9 1 2 3 4\nmy street.png 7 0.9 5 6 7 8\n")
    assert [box.corners.tolist() for box in read_boxes(file, "my street")] == [[1, 2, 3, 4]]


def test_coco_results_and_annotations(tmp_path):
    file = tmp_path / "c.json"
    entry = {"image_id": 3, "category_id": 3, "bbox": [10, 20, 30, 40]}
    file.write_text(json.dumps([entry, {**entry, "category_id": 1}, {**entry, "score": 0.1}, {**entry, "image_id": 4}]))
    (box,) = read_boxes(file, "000003")
    assert box.corners.tolist() == [10, 20, 40, 60]
    assert box.model is BoxModel.SURFACE
    whole = {
        "images": [{"id": 3, "file_name": "a/street.jpg"}, {"id": 4, "file_name": "b.jpg"}],
        "categories": [{"id": 7, "name": "car"}, {"id": 3, "name": "bench"}],
        "annotations": [entry, {**entry, "category_id": 7}],
    }
    file.write_text(json.dumps(whole))
    assert [box.name for box in read_boxes(file, "street")] == ["1"]


@pytest.mark.parametrize(
    "line",
    ["Car 1 2", f"Car {LABEL.replace('10.0', 'ten')}", f"Car {LABEL.replace('10.0', 'nan')}", "a.png 2 0.9 1 2 3 four"],
)
def test_bad_lines_are_named(tmp_path, line):
    file = tmp_path / "l.txt"
    file.write_text(f"Car {LABEL}\n{line}\n")
    with pytest.raises(InvalidInputError, match=r"l.txt:2"):
        read_boxes(file, "l")


def test_files_that_are_none(tmp_path):
    with pytest.raises(InvalidInputError, match="boxes"):
        read_boxes(tmp_path / "absent.txt", "a")
    (tmp_path / "c.json").write_text('"text"')
    with pytest.raises(InvalidInputError, match="COCO"):
        read_boxes(tmp_path / "c.json", "a")
