"""Reader of the 36-keypoint annotations of the VeRi vehicle images (PAMTRI): one CSV line per image."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from fgrecon.core.category import Category
from fgrecon.core.errors import InvalidInputError
from fgrecon.io.files import read_text
from fgrecon_research.io.annotations.annotations import Annotations

_POINTS = 36
_HEAD = 3


def read_veri36(path: Path, category: Category, rename: Mapping[str, str]) -> Annotations:
    """Annotations of a CSV file with lines `name, width, height, (u, v, visible) x 36[, more]`.

    The order of the 36 points is that of the category `car36`. The vehicle's identity is the part of the image's name
    before its first underscore. Points that are not visible are guesses of the annotators and are left out.

    Args:
        category: A category with 36 keypoints in that order.

    Raises:
        InvalidInputError: Not such a file, or a wrong value; names file, line, image and keypoint.
    """
    if category.size != _POINTS:
        raise InvalidInputError("category", category.name, f"Give a category with {_POINTS} keypoints, such as car36.")
    if rename:
        raise InvalidInputError("rename", ", ".join(rename), "Leave it out: this file holds no keypoint names.")
    text = read_text(path, "annotations")
    rows, names = [], []
    for number, cells in enumerate(csv.reader(text.splitlines()), start=1):
        if not cells:
            continue
        where = f"{path}: line {number}"
        if len(cells) < _HEAD + 3 * _POINTS:
            fix = f"Give name, width, height and u, v, visible for {_POINTS} keypoints."
            raise InvalidInputError(where, f"{len(cells)} values", fix)
        rows.append(_row(f"{where} ({cells[0]})", cells[_HEAD : _HEAD + 3 * _POINTS], category))
        names.append(cells[0])
    values = np.array(rows).reshape(-1, _POINTS, 3)
    keypoints = np.where(values[:, :, 2:] > 0, values[:, :, :2], np.nan)
    vehicles = np.array([name.partition("_")[0] for name in names])
    return Annotations(category, keypoints, tuple(names), vehicles, source=f"{path.name} (VeRi, 36 keypoints)")


def _row(where: str, cells: list[str], category: Category) -> list[float]:
    values = []
    for place, cell in enumerate(cells):
        try:
            value = float(cell)
        except ValueError:
            value = np.nan
        if not np.isfinite(value):
            name = category.keypoints[place // 3]
            raise InvalidInputError(f"{where}: {name}", cell, "Give a finite number.")
        values.append(value)
    return values
