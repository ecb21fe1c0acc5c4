"""Instances in other programs' names, brought to a category's; the rest of an instance is left as it is."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from fgrecon.core.category import Category
from fgrecon.core.errors import InvalidInputError
from fgrecon.io.json_fields import numbers
from fgrecon.io.keypoints.names import Names, naming_of, order_of

_EXTRA: Mapping[str, tuple[int, ...]] = {"confidence": (), "covariance": (2, 2)}
"""What may stand beside keypoints for each of them, and its shape."""


def translated(
    record: Mapping[str, Any], category: Category, names: Names | None, where: str
) -> tuple[dict[str, Any], set[str]]:
    """An instance in the layout of `fgrecon.io.keypoint_file`, its keypoints by the category's names.

    A keypoint that is the centre of several points is found where all of them are.

    Args:
        record: The instance; its points by name, or in an order that is the user's, the category's or a scheme's.
        names: What the user says of the names, or None.
        where: Put in front of every field that an error names.

    Returns:
        The instance, and the names of points that are no keypoint of the category.

    Raises:
        InvalidInputError: No point is a keypoint of the category, or a value is malformed; names the field.
    """
    points = _named(record, "keypoints", category, names, where)
    extra = {field: _named(record, field, category, names, where) for field in _EXTRA if record.get(field) is not None}
    known = names if names is not None and (names.groups or names.order) else naming_of(points, category)
    if known is None:
        fix = f"Say by `names` (--names) which keypoints of {category.name} these are."
        raise InvalidInputError(f"{where}keypoints", ", ".join(points) or "no name", fix)
    groups = {ours: known.groups.get(ours, (ours,)) for ours in category.keypoints}
    used = {theirs for group in groups.values() for theirs in group}
    if not used & set(points):
        fix = f"None is a keypoint of {category.name}; say by `names` (--names) which ones these are."
        raise InvalidInputError(f"{where}keypoints", ", ".join(points), fix)
    result = dict(record) | {"keypoints": _centres(points, groups, None, f"{where}keypoints")}
    for field, values in extra.items():
        result[field] = _centres(values, groups, _EXTRA[field], f"{where}{field}")
    return result, set(points) - used


def _named(
    record: Mapping[str, Any], field: str, category: Category, names: Names | None, where: str
) -> dict[str, Any]:
    """Values by name; names that are numbers are places in the user's order, where there is one."""
    given = record.get(field)
    if isinstance(given, Mapping):
        order = () if names is None or names.order is None else names.order
        places = {str(number): name for number, name in enumerate(order)}
        numbered = all(str(name) in places for name in given)
        named = {(places[str(name)] if numbered else str(name)): value for name, value in given.items()}
        return {name: value for name, value in named.items() if name is not None}
    if not isinstance(given, list):
        fix = "Give points by name, or a list of points."
        raise InvalidInputError(f"{where}{field}", "nothing" if given is None else given, fix)
    order = order_of(len(given), category, names, f"{where}{field}")
    return {name: value for name, value in zip(order, given, strict=True) if name is not None}


def _centres(
    values: Mapping[str, Any], groups: Mapping[str, tuple[str, ...]], shape: tuple[int, ...] | None, field: str
) -> dict[str, Any]:
    """Mean value of each group of which every member has one; without a shape they are points of 2 or 3 numbers."""
    centres: dict[str, Any] = {}
    for ours, theirs in groups.items():
        rows = [
            numbers(value, _shape_of(value) if shape is None else shape, f"{field}.{name}", missing=True)
            for name in theirs
            if (value := values.get(name)) is not None
        ]
        if len(rows) < len(theirs) or any(np.isnan(row).any() for row in rows):
            continue
        if len({row.shape for row in rows}) > 1:
            raise InvalidInputError(f"{field}.{theirs[0]}", values[theirs[0]], "Give all points a confidence, or none.")
        centres[ours] = np.mean(rows, axis=0).tolist()
    return centres


def _shape_of(value: Any) -> tuple[int, ...]:
    return (3,) if isinstance(value, list) and len(value) == 3 else (2,)
