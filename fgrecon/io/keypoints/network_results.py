"""Instances from what keypoint networks return in Python, or write as JSON: with classes, scores and tracks.

| object | known by |
|---|---|
| ultralytics' `Results` | `keypoints.xy`, `orig_shape` |
| `supervision.KeyPoints` | `xy` |
| MMPose's `PoseDataSample` | `pred_instances.keypoints`, `keypoint_scores` |
| torchvision's dictionary | `keypoints`, `keypoints_scores` |
| detectron2's `Instances` | `pred_keypoints`; or `instances` in a dictionary |
| norfair's `TrackedObject` | `estimate`, `live_points`: one vehicle, without the points that are not followed |

| JSON of | a vehicle has | its `keypoints` |
|---|---|---|
| ultralytics (`to_json`, `summary`) | `name`, `confidence`, `box` (`x1`, ...), `track_id` | lists `x`, `y`, `visible` |
| Roboflow | `class`, `confidence`, `x`, `y` (centre), `width`, `height` | objects `x`, `y`, `confidence`, `class` |
| MMPose | `bbox`, `bbox_score` | pairs; `keypoint_scores` beside them |

None of these packages is imported.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.arrays import Array
from fgrecon.core.category import Category
from fgrecon.core.checks import array_of
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.text import one_word
from fgrecon.io.json_fields import Fields, numbers
from fgrecon.io.keypoints.names import Names, order_of

Record = dict[str, Any]
_Records = Iterator[tuple[Record, str]]
PROBABLE = 0.5
"""Confidence of a point that is as likely right as wrong where networks have learnt probabilities."""
_HEAT = 0.05  # detectron2 draws no point whose share of the heat map is less
_FIX = (
    "Give results of ultralytics, torchvision, detectron2 or MMPose, `supervision.KeyPoints`, norfair's objects, "
    "OpenPifPaf's annotations or the content of a JSON file."
)


@dataclass(frozen=True)
class _Found:
    """What a network has found in an image."""

    field: str  # name of the pixels
    points: Array  # (N, P, 2) pixels
    confidence: Array | None = None  # (N, P), or None
    boxes: Array | None = None  # (N, 4) corners, or None
    scores: Array | None = None  # (N,), or None
    tracks: Array | None = None  # (N,), or None
    kinds: Sequence[str] | None = None  # N names of classes, or None
    shared: Mapping[str, Any] | None = None  # what every instance has


def is_network_result(given: Any) -> bool:
    """Whether a dictionary is what torchvision or detectron2 returns, and no content of a JSON file."""
    return isinstance(given, Mapping) and (
        hasattr(given.get("keypoints_scores"), "shape") or hasattr(given.get("instances"), "pred_keypoints")
    )


def object_records(given: Any, category: Category, names: Names | None, where: str = "") -> _Records:
    """Instances of an object in the layout of a keypoint file, and what errors about each begin with.

    Points at (0, 0) are those that a network did not find.

    Args:
        given: What a network returned for one image, as above.
        names: What the user says of the points, which have no names here.

    Raises:
        InvalidInputError: The object is none of these, or has an array of a wrong shape; names it.
    """
    points: Any = getattr(given, "keypoints", None)
    if isinstance(given, Mapping) and "keypoints_scores" in given:
        found = _torchvision(given, where)
    elif hasattr(points, "xy") and hasattr(given, "orig_shape"):
        found = _ultralytics(given, where)
    elif hasattr(getattr(given, "pred_instances", None), "keypoint_scores"):
        found = _mmpose(given.pred_instances, where)
    elif isinstance(given, Mapping) and hasattr(given.get("instances"), "pred_keypoints"):
        found = _detectron2(given["instances"], where)
    elif hasattr(given, "pred_keypoints"):
        found = _detectron2(given, where)
    elif hasattr(given, "estimate") and hasattr(given, "live_points"):
        found = _norfair(given, where)
    elif hasattr(given, "xy"):
        found = _supervision(given, where)
    else:
        raise InvalidInputError(f"{where}keypoints", type(given).__name__, _FIX)
    return _records(found, category, names)


def _ultralytics(given: Any, where: str) -> _Found:
    points, boxes, source = given.keypoints, getattr(given, "boxes", None), getattr(given, "path", None)
    classes, kinds = getattr(boxes, "cls", None), getattr(given, "names", None) or {}
    return _Found(
        f"{where}keypoints",
        array_of(points.xy, f"{where}keypoints.xy"),
        _optional(getattr(points, "conf", None), f"{where}conf"),
        _optional(getattr(boxes, "xyxy", None), f"{where}boxes.xyxy"),
        _optional(getattr(boxes, "conf", None), f"{where}boxes.conf"),
        _optional(getattr(boxes, "id", None), f"{where}boxes.id"),
        None if classes is None else [kinds.get(int(n), str(int(n))) for n in array_of(classes, f"{where}boxes.cls")],
        {"confidence_midpoint": PROBABLE}
        | ({"image": Path(source).name} if isinstance(source, str) else {})
        | ({} if given.orig_shape is None else {"image_size": [int(side) for side in given.orig_shape[1::-1]]}),
    )


def _supervision(given: Any, where: str) -> _Found:
    trust = next((getattr(given, n) for n in ("keypoint_confidence", "confidence") if hasattr(given, n)), None)
    kinds = (getattr(given, "data", None) or {}).get("class_name")
    return _Found(
        f"{where}xy",
        array_of(given.xy, f"{where}xy"),
        _optional(trust, f"{where}confidence"),
        scores=_optional(getattr(given, "detection_confidence", None), f"{where}detection_confidence"),
        kinds=None if kinds is None else [str(kind) for kind in kinds],
    )


def _norfair(given: Any, where: str) -> _Found:
    points, alive = array_of(given.estimate, f"{where}estimate"), np.asarray(given.live_points, dtype=bool)
    kind, number = getattr(given, "label", None), given.id
    return _Found(
        f"{where}estimate",
        np.where(alive[:, None], points, np.nan)[None],
        tracks=None if number is None else np.array([number], dtype=np.float64),
        kinds=None if kind is None else [str(kind)],
    )


def _mmpose(given: Any, where: str) -> _Found:
    return _Found(
        f"{where}pred_instances.keypoints",
        array_of(given.keypoints, f"{where}pred_instances.keypoints"),
        np.clip(array_of(given.keypoint_scores, f"{where}pred_instances.keypoint_scores"), 0.0, 1.0),
        _optional(getattr(given, "bboxes", None), f"{where}pred_instances.bboxes"),
        _optional(getattr(given, "bbox_scores", None), f"{where}pred_instances.bbox_scores"),
    )


def _torchvision(given: Mapping[str, Any], where: str) -> _Found:
    """Its third number is 1 for each point; its scores are heights of a heat map, taken for logarithms of odds."""
    points = array_of(given["keypoints"], f"{where}keypoints")
    height = array_of(given["keypoints_scores"], f"{where}keypoints_scores")
    return _Found(
        f"{where}keypoints",
        points[..., :2],
        1.0 / (1.0 + np.exp(-np.clip(height, -50.0, 50.0))),
        _optional(given.get("boxes"), f"{where}boxes"),
        _optional(given.get("scores"), f"{where}scores"),
        shared={"confidence_midpoint": PROBABLE},
    )


def _detectron2(given: Any, where: str) -> _Found:
    """Its third number is a pixel's share of the heat map: larger than 0, and small where that is broad."""
    points = array_of(given.pred_keypoints, f"{where}pred_keypoints")
    boxes = getattr(given, "pred_boxes", None)
    return _Found(
        f"{where}pred_keypoints",
        points[..., :2],
        np.clip(points[..., 2], 0.0, 1.0),
        _optional(getattr(boxes, "tensor", boxes), f"{where}pred_boxes"),
        _optional(getattr(given, "scores", None), f"{where}scores"),
        shared={"confidence_midpoint": _HEAT},
    )


def _records(found: _Found, category: Category, names: Names | None) -> _Records:
    """Instances from arrays."""
    points, confidence, field = found.points, found.confidence, found.field
    if points.ndim > 1 and points.size == 0:  # no vehicle
        return
    if points.ndim != 3 or points.shape[2] != 2:
        raise InvalidInputError(field, f"shape {points.shape}", "Give pixels (N, P, 2): N vehicles with P points each.")
    count = len(points)
    for name, array, shape in (
        ("confidence", confidence, points.shape[:2]),
        ("boxes.xyxy", found.boxes, (count, 4)),
        ("scores", found.scores, (count,)),
        ("tracks", found.tracks, (count,)),
        ("classes", None if found.kinds is None else np.array(found.kinds), (count,)),
    ):
        if array is not None and array.shape != shape:
            raise InvalidInputError(name, f"shape {array.shape}", f"Give {shape}, as there are {count} vehicles.")
    order = order_of(points.shape[1], category, names, field)
    measured = np.isfinite(points).all(axis=2) & (points != 0).any(axis=2)
    if confidence is not None:
        measured &= confidence > 0
    for number, pixels in enumerate(points):
        rows = pixels if confidence is None else np.column_stack([pixels, confidence[number]])
        record: dict[str, Any] = {"id": number} | dict(found.shared or {})
        record["keypoints"] = {
            name: row.tolist() for name, row, there in zip(order, rows, measured[number], strict=True) if name and there
        }
        if found.boxes is not None:
            record["box"] = found.boxes[number].tolist()
        if found.scores is not None and np.isfinite(found.scores[number]):
            record["score"] = float(found.scores[number])
        if found.tracks is not None and np.isfinite(found.tracks[number]):
            record["track"] = int(found.tracks[number])
        if found.kinds is not None:
            record["kind"] = one_word(found.kinds[number])
        yield record, f"{field}[{number}]: "


def _optional(value: Any, field: str) -> Array | None:
    return None if value is None else array_of(value, field)


def network_instances(data: Any) -> Sequence[Any] | None:
    """The vehicles of a file of one of these formats; None where it is none."""
    entries = data.get("predictions") if isinstance(data, Mapping) else data
    if isinstance(data, Mapping) and entries is None and _reader(data) is not None:
        return [data]
    if isinstance(entries, list) and entries and all(isinstance(item, list) for item in entries):
        entries = [item for image in entries for item in image]  # MMPose's inferencer: a list for each image
    if isinstance(entries, list) and entries and all(_reader(item) is not None for item in entries):
        return entries
    return None


def network_records(
    data: Sequence[Any], category: Category, names: Names | None, where: str
) -> Iterator[tuple[Record | InvalidInputError, str]]:
    """The vehicles in the layout of a keypoint file, and what errors about each begin with; one malformed is its error.

    Args:
        names: What the user says of points without names.
    """
    for number, item in enumerate(data):
        place = f"{where}[{number}]."
        read = _reader(item)
        assert read is not None
        try:
            yield {"id": number} | read(Fields(item, place), category, names), place
        except InvalidInputError as error:
            yield error, place


_Reader = Callable[[Fields, Category, Names | None], Record]


def _reader(item: Any) -> _Reader | None:
    """What reads a vehicle, known by what it has."""
    if not isinstance(item, Mapping):
        return None
    points = item.get("keypoints")
    if isinstance(points, Mapping) and {"x", "y"} <= points.keys() and isinstance(points["x"], list):
        return _ultralytics_record
    if isinstance(points, list) and points and all(isinstance(point, Mapping) and "x" in point for point in points):
        return _roboflow
    return _mmpose_record if "keypoint_scores" in item else None


def _ultralytics_record(fields: Fields, category: Category, names: Names | None) -> Record:
    points = fields.inner("keypoints")
    count = len(points.get("x", list))
    columns = [points.numbers(name, (count,)) for name in ("x", "y")]
    if "visible" in points:
        columns.append(points.numbers("visible", (count,)))
    rows = np.column_stack(columns)
    there = (rows[:, :2] != 0.0).any(axis=1) & (rows[:, -1] > 0.0 if len(columns) == 3 else True)
    record = _record_of(rows, there, order_of(count, category, names, f"{fields.where}keypoints"))
    if "box" in fields:
        box = fields.inner("box")
        record["box"] = [float(box.numbers(name, ())) for name in ("x1", "y1", "x2", "y2")]
    if "track_id" in fields:
        record["track"] = fields.whole("track_id")
    return record | _said(fields, "name", "confidence") | {"confidence_midpoint": PROBABLE}


def _roboflow(fields: Fields, category: Category, names: Names | None) -> Record:  # noqa: ARG001 - its points have names
    found = {}
    for number, point in enumerate(fields.each("keypoints")):
        name = point.data.get("class", point.data.get("class_name", number))
        rows = ("x", "y", *(["confidence"] if "confidence" in point else []))
        found[str(name)] = [float(point.numbers(part, ())) for part in rows]
    x, y, width, height = (float(fields.numbers(name, ())) for name in ("x", "y", "width", "height"))
    record: Record = {"keypoints": found, "confidence_midpoint": PROBABLE}
    record["box"] = [x - width / 2.0, y - height / 2.0, x + width / 2.0, y + height / 2.0]
    return record | _said(fields, "class", "confidence")


def _mmpose_record(fields: Fields, category: Category, names: Names | None) -> Record:
    count = len(fields.get("keypoints", list))
    rows = np.column_stack(
        [fields.numbers("keypoints", (count, 2)), np.clip(fields.numbers("keypoint_scores", (count,)), 0.0, 1.0)]
    )
    record = _record_of(rows, rows[:, 2] > 0.0, order_of(count, category, names, f"{fields.where}keypoints"))
    box = fields.data.get("bbox")
    if box is not None:  # the inferencer writes a list of one box
        one = box[0] if isinstance(box, list) and len(box) == 1 else box
        record["box"] = numbers(one, (4,), f"{fields.where}bbox").tolist()
    return record | _said(fields, "", "bbox_score")


def _record_of(rows: Array, there: NDArray[np.bool_], order: Sequence[str | None]) -> Record:
    """Points by their names, those that are there."""
    return {
        "keypoints": {n: row.tolist() for n, row, is_there in zip(order, rows, there, strict=True) if n and is_there}
    }


def _said(fields: Fields, kind: str, score: str) -> Record:
    """Class and score, as far as they are there."""
    found: Record = {}
    if kind and kind in fields:
        found["kind"] = one_word(fields.data[kind])
    if score in fields:
        found["score"] = float(fields.numbers(score, ()))
    return found
