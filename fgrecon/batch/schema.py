"""The tables of a run, by their columns and rows: of tasks, which workers get, and of results.

An instance is in a task as its JSON text, or by its fields as columns.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping, Sequence
from decimal import Decimal
from typing import Any

import pyarrow as pa

from fgrecon.core.errors import InvalidInputError
from fgrecon.io.arrow import without_pandas

SCHEMA_VERSION = 2
FORMAT = f"fgrecon.batch/{SCHEMA_VERSION}"

REFUSED, ERROR, EMPTY, LEFT_OUT = "refused", "error", "empty", "left_out"
"""Statuses of rows beside those of results: bad input, anything unforeseen, an image without a vehicle, and vehicles of
an image that the category does not cover."""

_TEXT, _NUMBER, _NUMBERS = pa.string(), pa.float64(), pa.list_(pa.float64())

_ALTERNATIVE = pa.struct(
    [("camera_T_object", _NUMBERS), ("coefficients", _NUMBERS), ("excess", _NUMBER), ("probability", _NUMBER)]
)


def task_schema() -> Any:
    """Columns of the tables that a run hands to its workers.

    row_id; source, the file it is from; frame, of a video; and one of: instance, the JSON text of an instance of a
    keypoint file; image, a file, with camera, the JSON text of the camera's fields, where it is known; problem, why the
    row could not be read.
    """
    texts = ("row_id", "source", "instance", "image", "camera", "problem")
    return pa.schema([*((name, _TEXT) for name in texts), ("frame", pa.int64())])


def result_schema() -> Any:
    """The columns of results (docs/reference/batch-table.md says what is in them), with the format in the metadata."""
    fields = [
        *((name, _TEXT) for name in ("row_id", "source")),
        ("frame", pa.int64()),
        *((name, _TEXT) for name in ("image", "kind")),
        ("track", pa.int64()),
        ("vehicle", pa.int32()),
        *((name, _TEXT) for name in ("id", "status", "error_type", "error_field", "error", "message")),
        *((name, _TEXT) for name in ("category", "prior")),
        *((name, _NUMBER) for name in ("rotation_y", "x", "y", "z", "length", "width", "height")),
        *((name, _NUMBER) for name in ("sigma_rotation", "sigma_translation")),
        *((name, _NUMBERS) for name in ("camera_T_object", "coefficients", "offsets")),
        ("keypoints", pa.list_(_TEXT)),
        *((name, _NUMBERS) for name in ("wireframe", "wireframe_uv", "weights", "sigmas", "visibility")),
        *((name, _NUMBERS) for name in ("pose_covariance", "coefficients_covariance", "size_covariance")),
        ("alternatives", pa.list_(_ALTERNATIVE)),
        ("facing_probability", _NUMBER),
        ("reasons", pa.list_(_TEXT)),
        ("regions", _TEXT),
        *((name, _NUMBERS) for name in ("camera_matrix", "distortion")),
        ("distortion_model", _TEXT),
        ("image_size", pa.list_(pa.int32())),
        ("box", _NUMBERS),
        ("score", _NUMBER),
        ("box_excess", _NUMBER),
        ("own_shares", pa.struct([(name, _NUMBER) for name in ("points", "depth")])),
        ("input_warning", _TEXT),
        ("left_out", pa.list_(_TEXT)),
        ("focal_sigma", _NUMBER),
        ("milliseconds", _NUMBER),
    ]
    return pa.schema(fields, metadata={"fgrecon.format": FORMAT})


Tasks = Sequence[Mapping[str, Any]]
"""Rows of `task_schema`: whoever hands them out makes no table of them, and needs no memory for that."""

_NO_FIELDS = ("row_id", "source", "frame", "instance", "image", "camera", "problem", "boxes")
"""Columns of tasks that are no fields of an instance."""


class TaskSolver:
    """Solves tasks by a function of tables; pickled with it, sent to each worker once."""

    def __init__(self, function: Callable[[Any], Any]) -> None:
        """Take what is called with a table of tasks: a `Reconstructor`."""
        self._function, self._begun = function, False

    def __call__(self, tasks: Tasks) -> Any:
        """A table of their results."""
        if not self._begun:
            without_pandas()
            self._begun = True
        return self._function(pa.Table.from_pylist(list(tasks), schema=task_schema()))


def instance_text(row: Mapping[str, Any]) -> str:
    """The JSON text of an instance whose fields are the columns of a row; what is missing is left out, NaN is null."""
    return json.dumps({name: _plain(value) for name, value in row.items() if value is not None})


def record_of(task: Mapping[str, Any]) -> Any:
    """What JSON holds of a row's instance.

    Raises:
        InvalidInputError: Its text is no JSON.
    """
    text = task.get("instance")
    if text is None:
        text = instance_text({name: value for name, value in task.items() if name not in _NO_FIELDS})
    try:
        return json.loads(text)
    except (ValueError, RecursionError) as error:
        raise InvalidInputError("instance", str(error), "Give an instance of a keypoint file as JSON.") from error


def _plain(value: Any) -> Any:
    """A column's value as JSON has it: NaN is null, and what JSON does not know is text."""
    if isinstance(value, float):
        return None if math.isnan(value) else value
    if isinstance(value, Decimal):
        return int(value) if value == value.to_integral_value() else float(value)
    if isinstance(value, list) and value and all(isinstance(item, tuple) for item in value):
        value = dict(value)  # a map, as Arrow gives it
    if isinstance(value, Mapping):
        return {key: _plain(item) for key, item in value.items() if item is not None}
    if isinstance(value, list):
        return [_plain(item) for item in value]
    return value if value is None or isinstance(value, str | int) else str(value)


def nested(record: Any, keypoints: int) -> Any:
    """An instance whose keypoints and K have their rows again where an engine has flattened them."""
    if not isinstance(record, dict):
        return record
    for name, count in {"keypoints": keypoints, "K": 3}.items():
        flat = record.get(name)
        if (
            isinstance(flat, list)
            and len(flat) in (2 * count, 3 * count)
            and not any(isinstance(i, list) for i in flat)
        ):
            width = len(flat) // count
            record = record | {name: [flat[i : i + width] for i in range(0, len(flat), width)]}
    return record
