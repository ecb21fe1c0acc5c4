"""Instances of what networks' libraries write as JSON: ultralytics' `to_json` and `summary`, Roboflow's, MMPose's.

| from | a vehicle has | its `keypoints` |
|---|---|---|
| ultralytics | `name`, `confidence`, `box` (`x1`, ...), `track_id` | lists `x`, `y`, `visible` |
| Roboflow | `class`, `confidence`, `x`, `y` (centre), `width`, `height` | objects `x`, `y`, `confidence`, `class` |
| MMPose | `bbox`, `bbox_score` | pairs; `keypoint_scores` beside them |
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.arrays import Array
from fgrecon.core.category import Category
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.text import one_word
from fgrecon.io.json_fields import Fields, numbers
from fgrecon.io.keypoints.names import Names, order_of
from fgrecon.io.keypoints.network_results import PROBABLE

Record = dict[str, Any]


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
        data: Those of `network_instances`.
        category: The category whose keypoints are wanted.
        names: What the user says of points without names.
        where: What errors begin with.
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
        return _ultralytics
    if isinstance(points, list) and points and all(isinstance(point, Mapping) and "x" in point for point in points):
        return _roboflow
    return _mmpose if "keypoint_scores" in item else None


def _ultralytics(fields: Fields, category: Category, names: Names | None) -> Record:
    points = fields.inner("keypoints")
    count = len(points.get("x", list))
    columns = [points.numbers(name, (count,)) for name in ("x", "y")]
    if "visible" in points:
        columns.append(points.numbers("visible", (count,)))
    rows = np.column_stack(columns)
    there = (rows[:, :2] != 0.0).any(axis=1) & (rows[:, -1] > 0.0 if len(columns) == 3 else True)
    record = _named(rows, there, order_of(count, category, names, f"{fields.where}keypoints"))
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


def _mmpose(fields: Fields, category: Category, names: Names | None) -> Record:
    count = len(fields.get("keypoints", list))
    rows = np.column_stack(
        [fields.numbers("keypoints", (count, 2)), np.clip(fields.numbers("keypoint_scores", (count,)), 0.0, 1.0)]
    )
    record = _named(rows, rows[:, 2] > 0.0, order_of(count, category, names, f"{fields.where}keypoints"))
    box = fields.data.get("bbox")
    if box is not None:  # the inferencer writes a list of one box
        one = box[0] if isinstance(box, list) and len(box) == 1 else box
        record["box"] = numbers(one, (4,), f"{fields.where}bbox").tolist()
    return record | _said(fields, "", "bbox_score")


def _named(rows: Array, there: NDArray[np.bool_], order: Sequence[str | None]) -> Record:
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
