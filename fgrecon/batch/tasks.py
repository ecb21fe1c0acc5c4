"""The tasks of a run: plain rows that workers get, and of which they make tables of results.

An instance is in a row as its JSON text, or by its fields as columns.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping, Sequence
from decimal import Decimal
from typing import Any

import pyarrow as pa

from fgrecon.batch.schema import task_schema
from fgrecon.core.errors import InvalidInputError
from fgrecon.io.arrow import without_pandas

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
