"""Instances as rows of tables hold them: JSON text, or their fields as columns."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from decimal import Decimal
from typing import Any

from fgrecon.core.errors import InvalidInputError

__all__ = ["instance_text", "nested", "record_of"]

Row = dict[str, Any]


def instance_text(row: Mapping[str, Any]) -> str:
    """The JSON text of an instance whose fields are the columns of a row; what is missing is left out, NaN is null."""
    return json.dumps({name: _plain(value) for name, value in row.items() if value is not None})


def record_of(task: Mapping[str, Any]) -> Any:
    """What JSON holds of a row's instance.

    Raises:
        InvalidInputError: Its text is no JSON.
    """
    text = task["instance"] if task.get("instance") is not None else instance_text(_fields(task))
    try:
        return json.loads(text)
    except (ValueError, RecursionError) as error:
        raise InvalidInputError("instance", str(error), "Give an instance of a keypoint file as JSON.") from error


def _fields(task: Mapping[str, Any]) -> Row:
    aside = ("row_id", "source", "frame", "instance", "image", "camera", "problem", "boxes")
    return {name: value for name, value in task.items() if name not in aside}


def _plain(value: Any) -> Any:
    """A column's value as JSON has it: NaN is null, and what JSON does not know is text."""
    if isinstance(value, float):
        return None if math.isnan(value) else value
    if isinstance(value, Decimal):
        return int(value) if value == value.to_integral_value() else float(value)
    if isinstance(value, Mapping):
        return {key: _plain(item) for key, item in value.items() if item is not None}
    if isinstance(value, list):
        if value and all(isinstance(item, tuple) for item in value):  # a map, as Arrow gives it
            return {key: _plain(item) for key, item in value if item is not None}
        return [_plain(item) for item in value]
    return value if value is None or isinstance(value, str | int) else str(value)


def nested(record: Any, keypoints: int) -> Any:
    """An instance whose keypoints and K have their rows again where an engine has flattened them."""
    if not isinstance(record, dict):
        return record
    sizes = {"keypoints": keypoints, "K": 3}
    for name, count in sizes.items():
        flat = record.get(name)
        if (
            isinstance(flat, list)
            and len(flat) in (2 * count, 3 * count)
            and not any(isinstance(i, list) for i in flat)
        ):
            width = len(flat) // count
            record = record | {name: [flat[i : i + width] for i in range(0, len(flat), width)]}
    return record
