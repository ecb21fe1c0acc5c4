"""Keypoints marked by hand: the test set of the networks, never learnt from, and the few that the training is given."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.arrays import Array
from fgrecon.core.category import Category
from fgrecon.core.errors import InvalidInputError
from fgrecon.io.json_fields import Fields, read_records

_WHAT = "a list of marked cars"


@dataclass(frozen=True)
class Mark:
    """One car with its keypoints."""

    image: Path  # the photograph's file
    name: str  # name of the car
    group: str  # what it is counted under: `photographs`, or `easy`, `moderate`, `hard`
    box: Array  # (4,) x1, y1, x2, y2 in pixels
    keypoints: Array  # (K, 2) pixels
    visible: NDArray[np.bool_]  # (K,) whether each can be seen; others hold a guess and are not scored

    @property
    def extent(self) -> float:
        """Longer side of the box, pixels."""
        return float((self.box[2:] - self.box[:2]).max())


def read_photograph_marks(path: Path, images: Path, size: int = 14) -> list[Mark]:
    """Marks on photographs that show one car each and are cropped to it.

    Raises:
        InvalidInputError: The file is malformed; names the field.
    """
    marks = []
    for fields in read_records(path, _WHAT):
        name = fields.get("image", str)
        width, height = fields.get("width", int), fields.get("height", int)
        box = np.array([-0.5, -0.5, width - 0.5, height - 0.5])
        marks.append(Mark(images / name, name, "photographs", box, *_keypoints(fields, size)))
    return marks


def read_street_marks(path: Path, images: Path, size: int = 14) -> list[Mark]:
    """Marks on the cars of street images; the name is `frame/line of the label file`.

    Raises:
        InvalidInputError: The file is malformed; names the field.
    """
    marks = []
    for fields in read_records(path, _WHAT):
        frame = fields.get("frame", str)
        name = f"{frame}/{fields.get('object_index', int)}"
        box = fields.numbers("box_xyxy", (4,))
        marks.append(Mark(images / f"{frame}.png", name, fields.get("regime", str), box, *_keypoints(fields, size)))
    return marks


def read_given_marks(path: Path, images: Sequence[str], category: Category) -> Array:
    """Marks of a few keypoints in photographs that are learnt from: what no model of the shapes tells.

    Args:
        path: JSON file: a list of `{"image": NAME, "keypoints": {NAME: [u, v], ...}}`.

    Returns:
        (M, K, 2) pixels; NaN where nothing is marked.

    Raises:
        InvalidInputError: The file is malformed, or marks another photograph or keypoint; names the field.
    """
    marks = np.full((len(images), category.size, 2), np.nan)
    rows = {name: row for row, name in enumerate(images)}
    for fields in read_records(path, _WHAT):
        name, points = fields.get("image", str), fields.inner("keypoints")
        if name not in rows:
            raise InvalidInputError(f"{fields.where}image", name, "Give a photograph that is learnt from.")
        for keypoint in points.data:
            if keypoint not in category.keypoints:
                raise InvalidInputError(f"{points.where}{keypoint}", "no keypoint", f"{category.name} has none of it.")
            marks[rows[name], category.keypoints.index(keypoint)] = points.numbers(keypoint, (2,))
    return marks


def _keypoints(fields: Fields, size: int) -> tuple[Array, NDArray[np.bool_]]:
    visible = fields.get("visible", list)
    if len(visible) != size or not all(isinstance(seen, bool) for seen in visible):
        raise InvalidInputError(f"{fields.where}visible", visible, f"Give a list of {size} true or false.")
    return fields.numbers("keypoints_uv", (size, 2)), np.array(visible, dtype=bool)
