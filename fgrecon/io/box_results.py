"""Boxes from the Python objects of detectors and trackers, with class, score and id. None of them is imported.

Ids that are no numbers, as motpy's, become the CRC 32 of their text. Boxes of id -1, which `trackers` gives to all that
it does not follow yet, are left out.

| object | known by | numbers of classes |
|---|---|---|
| `supervision.Detections` | `xyxy`, `class_id` | by `data["class_name"]`, else COCO's 80 |
| ultralytics' `Results` | `boxes.xyxy` | by its `names` |
| torchvision's dictionary | `boxes`, `labels` | COCO's 91 |
| detectron2's `Instances` | `pred_boxes` | COCO's 80 |
| a list of motpy's `Track` | `box`, `class_id` | COCO's 80 |
| a list of norfair's `TrackedObject` or `Detection` | `estimate` or `points` (2, 2) | by `label` |
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any
from zlib import crc32

import numpy as np

from fgrecon.core.checks import array_of
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.options import BoxModel
from fgrecon.core.text import one_word
from fgrecon.io.boxes import COCO_CLASSES, YOLO_CLASSES, NamedBox
from fgrecon.io.catalogue import class_of_kind

_Row = tuple[Any, Any, Any, Any]  # corners, class, score, id
_CAR = "car"


def boxes_from(given: Any) -> list[NamedBox] | None:
    """The vehicles among the boxes of an image; None where the object is none of these.

    Those that are no vehicles are left out; where no class is given, all are cars.

    Raises:
        InvalidInputError: An array has a wrong shape, or a number is not finite; names it.
    """
    found = _rows(given)
    if found is None:
        return None
    boxes = []
    for number, (corners, kind, score, track) in enumerate(found):
        name = _CAR if kind is None else one_word(kind)
        if isinstance(track, int) and track < 0:
            continue  # what a tracker of `trackers` does not follow yet
        known = class_of_kind(name)
        if known is None and name.lower() != _CAR:
            continue
        box = array_of(corners, f"boxes[{number}]").reshape(-1)
        if box.shape != (4,) or not np.isfinite(box).all():
            raise InvalidInputError(f"boxes[{number}]", box.tolist(), "Give x1, y1, x2, y2 in pixels.")
        label = str(number if track is None else track)
        sure = None if score is None else float(score)
        follows = None if track is None else int(label) if label.isdecimal() else crc32(label.encode())
        boxes.append(NamedBox(label, box, BoxModel.SURFACE, sure, follows, name, known))
    return boxes


def _rows(given: Any) -> list[_Row] | None:
    inner: Any = getattr(given, "boxes", None)
    if hasattr(given, "xyxy") and hasattr(given, "class_id"):
        names = (getattr(given, "data", None) or {}).get("class_name")
        kinds = names if names is not None else _named(given.class_id, YOLO_CLASSES)
        return _columns(given.xyxy, kinds, given.confidence, given.tracker_id)
    if hasattr(inner, "xyxy") and hasattr(given, "orig_shape"):
        return _columns(inner.xyxy, _named(inner.cls, given.names), inner.conf, getattr(inner, "id", None))
    if isinstance(given, Mapping) and "boxes" in given:
        return _columns(given["boxes"], _named(given.get("labels"), COCO_CLASSES), given.get("scores"))
    if hasattr(given, "pred_boxes"):
        kinds = _named(getattr(given, "pred_classes", None), YOLO_CLASSES)
        corners = getattr(given.pred_boxes, "tensor", given.pred_boxes)
        return _columns(corners, kinds, getattr(given, "scores", None))
    if isinstance(given, Sequence) and not isinstance(given, str) and all(map(_is_tracked, given)):
        return [_tracked(one) for one in given]
    return None


def _is_tracked(one: Any) -> bool:
    return hasattr(one, "box") or hasattr(one, "estimate") or hasattr(one, "points")


def _tracked(one: Any) -> _Row:
    """Of a tracker; norfair's has as many scores as points, in its last detection."""
    if hasattr(one, "box"):
        number = getattr(one, "class_id", None)
        kind = None if number is None else YOLO_CLASSES.get(int(number), str(number))
        return one.box, kind, getattr(one, "score", None), getattr(one, "id", None)
    detection = getattr(one, "last_detection", one)
    scores = getattr(detection, "scores", None)
    corners = one.estimate if hasattr(one, "estimate") else one.points
    score = None if scores is None else float(np.min(scores))
    return corners, getattr(one, "label", None), score, getattr(one, "id", None)


def _named(numbers: Any, names: Mapping[int, str]) -> list[str] | None:
    """The names of classes."""
    if numbers is None:
        return None
    return [names.get(int(number), str(int(number))) for number in array_of(numbers, "classes").reshape(-1)]


def _columns(corners: Any, kinds: Iterable[Any] | None, scores: Any, tracks: Any = None) -> list[_Row]:
    boxes = array_of(corners, "boxes")
    rest = [
        [None] * len(boxes) if column is None else list(column)
        for column in (
            kinds,
            None if scores is None else array_of(scores, "scores"),
            None if tracks is None else [int(number) for number in array_of(tracks, "ids")],
        )
    ]
    if boxes.size and (boxes.ndim != 2 or boxes.shape[1] != 4 or any(len(column) != len(boxes) for column in rest)):
        value = f"shape {boxes.shape}, {', '.join(str(len(column)) for column in rest)} classes, scores and ids"
        raise InvalidInputError("boxes", value, "Give boxes (N, 4), and N of what else there is.")
    return list(zip(boxes, *rest, strict=True)) if boxes.size else []
