"""The call signatures that detectors fit, the package's as well as your own, and the check of what they return.

    image ---- VehicleDetector ---- boxes ---- KeypointDetector ---- Detection of each vehicle

Nothing is inherited and nothing registered: whatever can be called like this can be given to `reconstruct_image`.

A vehicle detector may return what others do, with class, score and id; none of them is imported. Ids that are no
numbers, as motpy's, become the CRC 32 of their text. Boxes of id -1, which `trackers` gives to all that it does not
follow yet, are left out.

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
from typing import Any, Protocol, runtime_checkable
from zlib import crc32

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.category import Category
from fgrecon.core.checks import array_of
from fgrecon.core.choices import ClassSource
from fgrecon.core.detection import Detection
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.evidence import VehicleClass
from fgrecon.core.observation import Observation
from fgrecon.core.options import BoxModel
from fgrecon.core.text import one_word
from fgrecon.io.boxes import COCO_CLASSES, YOLO_CLASSES, NamedBox
from fgrecon.io.catalogue import class_of_kind
from fgrecon.perception.vehicles import Vehicles


@runtime_checkable
class VehicleDetector(Protocol):
    """Finds the vehicles in an image."""

    def __call__(self, image: NDArray[np.uint8], /) -> Vehicles:
        """Boxes (N, 4) and scores (N,) of the vehicles in an image (H, W, 3) of RGB bytes."""


@runtime_checkable
class KeypointDetector(Protocol):
    """Finds the keypoints of vehicles whose boxes are known."""

    @property
    def category(self) -> str:
        """Name of the category whose keypoints it finds, in the order of that category."""

    def __call__(
        self, image: NDArray[np.uint8], boxes: NDArray[np.float64], /
    ) -> Sequence[Observation] | Sequence[Detection]:
        """The keypoints of each vehicle, in the order of the boxes.

        Args:
            image: (H, W, 3) RGB bytes.
            boxes: (N, 4) x1, y1, x2, y2 in pixels.

        Returns:
            N observations, or detections where it also knows from where a vehicle is seen. Let each have its box: the
            solver uses it.
        """


def find_vehicles(detector: VehicleDetector, image: NDArray[np.uint8]) -> Vehicles:
    """What a vehicle detector finds in an image (H, W, 3): `Vehicles`, or an object of `fgrecon.perception.protocols`.

    Raises:
        InvalidInputError: It cannot be called, or returns something else.
    """
    if not callable(detector):
        raise InvalidInputError("vehicle_detector", detector, "Give what can be called with an image.")
    found: object = detector(image)
    if isinstance(found, Vehicles):
        return found
    boxes = boxes_from(found)
    if boxes is None:
        fix = "Let it return `fgrecon.perception.Vehicles(boxes, scores)`, or what a known detector or tracker returns."
        raise InvalidInputError("vehicle_detector", f"a returned {type(found).__name__}", fix)
    return _vehicles(boxes)


def _vehicles(boxes: Sequence[NamedBox]) -> Vehicles:
    """Boxes by falling score; one without a score is certain, and beside tracks one without an id is not yet sure."""
    tracked = [box for box in boxes if box.track is not None]
    order = sorted(tracked or boxes, key=lambda box: -1.0 if box.score is None else -box.score)
    corners = np.array([box.corners for box in order]).reshape(-1, 4)
    classes = [box.vehicle_class for box in order]
    return Vehicles(
        corners,
        np.array([1.0 if box.score is None else box.score for box in order]),
        tuple(box.kind or "car" for box in order),
        tuple(one for one in classes if one is not None) if None not in classes else (),
        tuple(box.track for box in order if box.track is not None),
    )


def check_category(detector: object, category: Category) -> None:
    """Refuse a detector of one category beside a shape prior of another."""
    if not isinstance(detector, KeypointDetector):
        fix = "Give what can be called with an image and boxes, and has `category`, the name of its category."
        raise InvalidInputError("keypoint_detector", detector, fix)
    if detector.category != category.name:
        fix = f"The prior's is {category.name}: give a detector and a prior of one category."
        raise InvalidInputError("keypoint_detector.category", detector.category, fix)


def class_by(
    source: ClassSource | None, boxed: VehicleClass | None, kinds: Mapping[str, float] | None
) -> VehicleClass | None:
    """Of which class a vehicle is, by who is to say it; None where nobody is, or does.

    Args:
        boxed: What is said with its box.
        kinds: What the keypoint detector says (`Detection.kinds`).
    """
    if source is not ClassSource.KEYPOINTS:
        return None if source is None else boxed
    return None if kinds is None else VehicleClass(kinds)


def find_keypoints(
    detector: KeypointDetector, image: NDArray[np.uint8], boxes: NDArray[np.float64], category: Category
) -> list[Detection]:
    """What a keypoint detector finds in boxes (N, 4) of an image (H, W, 3); for no box it is not asked.

    Raises:
        InvalidInputError: It is none, is of another category, or returns something else than a detection for each box.
    """
    check_category(detector, category)
    if not len(boxes):
        return []
    found: Any = detector(image, boxes)
    fix = f"Let it return an `fgrecon.Observation` or `fgrecon.Detection` for each of the {len(boxes)} boxes."
    if not isinstance(found, Sequence):
        raise InvalidInputError("keypoint_detector", f"a returned {type(found).__name__}", fix)
    if len(found) != len(boxes):
        raise InvalidInputError("keypoint_detector", f"{len(found)} returned detections", fix)
    return [_detection(number, item, category, fix) for number, item in enumerate(found)]


def _detection(number: int, found: Any, category: Category, fix: str) -> Detection:
    field = f"keypoint_detector: detection[{number}]"
    detection = Detection(found) if isinstance(found, Observation) else found
    if not isinstance(detection, Detection):
        raise InvalidInputError(field, f"a returned {type(found).__name__}", fix)
    count = len(detection.observation.keypoints)
    if count != category.size:
        raise InvalidInputError(field, f"{count} keypoints", f"Category {category.name} has {category.size}.")
    return detection


_BoxRow = tuple[Any, Any, Any, Any]  # corners, class, score, id
_CAR = "car"


def boxes_from(given: Any) -> list[NamedBox] | None:
    """The vehicles among the boxes of an image; None where the object is none of these.

    Those that are no vehicles are left out; where no class is given, all are cars.

    Raises:
        InvalidInputError: An array has a wrong shape, or a number is not finite; names it.
    """
    found = _box_rows(given)
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


def _box_rows(given: Any) -> list[_BoxRow] | None:
    inner: Any = getattr(given, "boxes", None)
    if hasattr(given, "xyxy") and hasattr(given, "class_id"):
        names = (getattr(given, "data", None) or {}).get("class_name")
        kinds = names if names is not None else _class_names(given.class_id, YOLO_CLASSES)
        return _columns(given.xyxy, kinds, given.confidence, given.tracker_id)
    if hasattr(inner, "xyxy") and hasattr(given, "orig_shape"):
        return _columns(inner.xyxy, _class_names(inner.cls, given.names), inner.conf, getattr(inner, "id", None))
    if isinstance(given, Mapping) and "boxes" in given:
        return _columns(given["boxes"], _class_names(given.get("labels"), COCO_CLASSES), given.get("scores"))
    if hasattr(given, "pred_boxes"):
        kinds = _class_names(getattr(given, "pred_classes", None), YOLO_CLASSES)
        corners = getattr(given.pred_boxes, "tensor", given.pred_boxes)
        return _columns(corners, kinds, getattr(given, "scores", None))
    if isinstance(given, Sequence) and not isinstance(given, str) and all(map(_is_tracked, given)):
        return [_tracked(one) for one in given]
    return None


def _is_tracked(one: Any) -> bool:
    return hasattr(one, "box") or hasattr(one, "estimate") or hasattr(one, "points")


def _tracked(one: Any) -> _BoxRow:
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


def _class_names(numbers: Any, names: Mapping[int, str]) -> list[str] | None:
    """The names of classes."""
    if numbers is None:
        return None
    return [names.get(int(number), str(int(number))) for number in array_of(numbers, "classes").reshape(-1)]


def _columns(corners: Any, kinds: Iterable[Any] | None, scores: Any, tracks: Any = None) -> list[_BoxRow]:
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
