"""Boxes of detectors and trackers in Python; `tests/formats/test_networks.py` has the packages' own objects."""

import zlib
from collections import namedtuple
from types import SimpleNamespace

import numpy as np
import pytest

from fgrecon.core.errors import InvalidInputError
from fgrecon.perception.protocols import boxes_from, find_vehicles

BOX, OTHER = [10.0, 20.0, 110.0, 80.0], [5.0, 6.0, 7.0, 8.0]
Track = namedtuple("Track", "id box score class_id")


def supervision(**changed):
    given = {"xyxy": np.array([OTHER, BOX]), "confidence": np.array([0.9, 0.5]), "class_id": np.array([0, 2])}
    return SimpleNamespace(**{**given, "tracker_id": np.array([3, 7]), "data": {}} | changed)


def ultralytics():
    boxes = SimpleNamespace(xyxy=[OTHER, BOX], cls=[0.0, 1.0], conf=[0.9, 0.5], id=[3.0, 7.0])
    return SimpleNamespace(boxes=boxes, names={0: "dog", 1: "car"}, orig_shape=(90, 120))


def detectron2():
    boxes = SimpleNamespace(tensor=np.array([OTHER, BOX]))
    return SimpleNamespace(pred_boxes=boxes, pred_classes=np.array([0, 2]), scores=np.array([0.9, 0.5]))


def norfair(number, corners, label):
    last = SimpleNamespace(scores=np.array([0.7, 0.5]))
    return SimpleNamespace(id=number, estimate=np.reshape(corners, (2, 2)), label=label, last_detection=last)


@pytest.mark.parametrize(
    ("given", "track"),
    [
        (supervision(), 7),
        (supervision(class_id=None, data={"class_name": np.array(["person", "car"])}), 7),
        (ultralytics(), 7),
        ({"boxes": np.array([OTHER, BOX]), "labels": np.array([1, 3]), "scores": np.array([0.9, 0.5])}, None),
        (detectron2(), None),
        ([Track("a-b", np.array(OTHER), 0.9, 0), Track("c-d", np.array(BOX), 0.5, 2)], zlib.crc32(b"c-d")),
        ([norfair(3, OTHER, "person"), norfair(7, BOX, "car")], 7),
    ],
    ids=["supervision", "supervision-names", "ultralytics", "torchvision", "detectron2", "motpy", "norfair"],
)
def test_the_car_is_kept_with_class_score_and_id(given, track):
    (box,) = boxes_from(given)
    assert box.corners.tolist() == BOX
    assert (box.kind, box.score, box.track) == ("car", 0.5, track)
    found = find_vehicles(lambda _: given, np.zeros((90, 120, 3), np.uint8))
    assert (found.boxes.tolist(), found.scores.tolist(), found.kinds) == ([BOX], [0.5], ("car",))
    assert found.tracks == (() if track is None else (track,))


def test_no_box_and_no_class():
    empty = supervision(xyxy=np.zeros((0, 4)), confidence=np.zeros(0), class_id=np.zeros(0), tracker_id=None)
    assert boxes_from(empty) == []
    assert len(find_vehicles(lambda _: empty, np.zeros((9, 9, 3), np.uint8))) == 0
    assert boxes_from(supervision(tracker_id=np.array([-1, -1]))) == []
    bare = supervision(class_id=None, confidence=None, tracker_id=None)
    assert [(box.kind, box.score, box.name) for box in boxes_from(bare)] == [("car", None, "0"), ("car", None, "1")]
    assert boxes_from(np.zeros((1, 4))) is None
    assert boxes_from("boxes") is None


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (supervision(xyxy=np.zeros((2, 3))), r"boxes: got shape \(2, 3\)"),
        (supervision(tracker_id=np.array([1])), r"boxes: got shape \(2, 4\), 2, 2, 1 classes, scores and ids"),
        ([Track("a", np.array([1.0, np.nan, 2.0, 3.0]), 1.0, 2)], r"boxes\[0\]: got"),
    ],
)
def test_wrong_arrays_are_named(given, message):
    with pytest.raises(InvalidInputError, match=message):
        boxes_from(given)
