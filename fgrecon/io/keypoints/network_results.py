"""Instances from what keypoint networks return in Python: results of ultralytics, supervision and OpenPifPaf.

None of these packages is imported: an object is known by what it has.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.category import Category
from fgrecon.core.checks import hidden_as_nan
from fgrecon.core.errors import InvalidInputError
from fgrecon.io.keypoints.names import Names, order_of

Array = NDArray[np.float64]
_Records = Iterator[tuple[dict[str, Any], str]]
_PROBABLE = 0.5  # ultralytics learns confidences as the probability that a point is visible
_FIX = "Give results of ultralytics, `supervision.KeyPoints`, OpenPifPaf's annotations, or the content of a JSON file."


def object_records(given: Any, category: Category, names: Names | None, where: str = "") -> _Records:
    """Instances of an object in the layout of a keypoint file, and what errors about each begin with.

    Points at (0, 0) are those that a network did not find.

    Args:
        given: `ultralytics` results of one image, or `supervision.KeyPoints`.
        category: The category whose keypoints are wanted.
        names: What the user says of the points, which have no names here.
        where: What errors begin with.

    Raises:
        InvalidInputError: The object is neither, or has an array of a wrong shape; names it.
    """
    points: Any = getattr(given, "keypoints", None)
    if hasattr(points, "xy") and hasattr(given, "orig_shape"):
        boxes = getattr(given, "boxes", None)
        corners = None if boxes is None else _array(getattr(boxes, "xyxy", None), f"{where}boxes.xyxy")
        source = getattr(given, "path", None)
        return _records(
            (_array(points.xy, f"{where}keypoints.xy"), _optional(getattr(points, "conf", None), f"{where}conf")),
            (category, names, f"{where}keypoints"),
            corners,
            {"confidence_midpoint": _PROBABLE} | ({"image": Path(source).name} if isinstance(source, str) else {}),
        )
    if hasattr(given, "xy"):
        trust = next((getattr(given, n) for n in ("keypoint_confidence", "confidence") if hasattr(given, n)), None)
        return _records(
            (_array(given.xy, f"{where}xy"), _optional(trust, f"{where}confidence")),
            (category, names, f"{where}xy"),
            None,
            {},
        )
    raise InvalidInputError(f"{where}keypoints", type(given).__name__, _FIX)


def _records(
    found: tuple[Array, Array | None],
    naming: tuple[Category, Names | None, str],
    boxes: Array | None,
    shared: Mapping[str, Any],
) -> _Records:
    """Instances from arrays.

    Args:
        found: (N, P, 2) pixels, and (N, P) confidences or None.
        naming: The category, the user's names, and the name of the pixels.
        boxes: (N, 4) corners, or None.
        shared: What every instance has.
    """
    points, confidence = found
    category, names, field = naming
    if points.ndim > 1 and points.size == 0:  # no vehicle
        return
    if points.ndim != 3 or points.shape[2] != 2:
        raise InvalidInputError(field, f"shape {points.shape}", "Give pixels (N, P, 2): N vehicles with P points each.")
    for name, array, shape in (
        ("confidence", confidence, points.shape[:2]),
        ("boxes.xyxy", boxes, (len(points), 4)),
    ):
        if array is not None and array.shape != shape:
            raise InvalidInputError(name, f"shape {array.shape}", f"Give {shape}, as there are {len(points)} vehicles.")
    order = order_of(points.shape[1], category, names, field)
    seen = np.isfinite(points).all(axis=2) & (points != 0).any(axis=2)
    if confidence is not None:
        seen &= confidence > 0
    for number, pixels in enumerate(points):
        rows = pixels if confidence is None else np.column_stack([pixels, confidence[number]])
        keypoints = {
            name: row.tolist() for name, row, there in zip(order, rows, seen[number], strict=True) if name and there
        }
        box = {} if boxes is None else {"box": boxes[number].tolist()}
        yield {"id": number, "keypoints": keypoints, **box, **shared}, f"{field}[{number}]: "


def _optional(value: Any, field: str) -> Array | None:
    return None if value is None else _array(value, field)


def _array(value: Any, field: str) -> Array:
    """Numbers of an array or of a tensor on any device."""
    for step in ("detach", "cpu"):
        value = getattr(value, step, lambda same=value: same)()
    try:
        return hidden_as_nan(value, np.asarray(value, dtype=np.float64))
    except (TypeError, ValueError) as error:
        raise InvalidInputError(field, value, "Give an array of numbers.") from error
