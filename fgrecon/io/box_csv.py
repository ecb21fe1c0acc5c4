"""2D boxes in CSV files with a heading: of ultralytics, supervision, TensorFlow, VIA-like tools and one's own.

| what | names of its column, in capitals or not |
|---|---|
| image | `image`, `filename`, `file_name`, `file`, `path`, `image_name`, `image_path`, `image_id` |
| class | `class_name`, `name`, `category`, `label`, `class`, `kind`, `type`, `class_id`; a number is YOLO's |
| box | `x1,y1,x2,y2`, `xmin,ymin,xmax,ymax`, `left,top,right,bottom`; or `x,y,w,h`, `left,top,width,height` |
| score, track | `score`, `confidence`, `conf`; `track`, `track_id`, `tracker_id` |
| size of the image | `image_width,image_height`; `width,height` where the box has two corners |
"""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.errors import InvalidInputError
from fgrecon.io.files import read_text

_IMAGE = ("image", "filename", "file_name", "file", "path", "image_name", "image_path", "image_id")
_KIND = ("class_name", "name", "category_name", "category", "label", "class", "kind", "type", "class_id", "category_id")
_SCORE, _TRACK = ("score", "confidence", "conf"), ("track", "track_id", "tracker_id")
_CORNERS = (
    ("x1", "y1", "x2", "y2"),
    ("xmin", "ymin", "xmax", "ymax"),
    ("x_min", "y_min", "x_max", "y_max"),
    ("left", "top", "right", "bottom"),
)
_SIDES = tuple(
    (*corner, *sides)
    for corner in (("x", "y"), ("left", "top"), ("bbox_x", "bbox_y"), ("bbox_left", "bbox_top"))
    for sides in (("w", "h"), ("width", "height"), ("bbox_w", "bbox_h"), ("bbox_width", "bbox_height"))
)
_SIZES = ("image_width", "image_height")
_FIX = (
    "Give a heading: image, class, score and x1,y1,x2,y2 (or x,y,w,h of the upper left corner), in pixels; of several "
    "images the image's name is needed."
)


@dataclass(frozen=True)
class CsvBox:
    """A row."""

    corners: NDArray[np.float64]  # (4,) x1, y1, x2, y2 in pixels
    kind: str  # its class; its number as text where the file has no names; `car` where there is no such column
    image: str | None  # name of its image, or None
    score: float | None  # or None
    track: int | None  # or None
    size: tuple[int, int] | None  # width and height that the row states of its image, or None


def read_csv_boxes(file: Path) -> list[CsvBox]:
    """The boxes of a file.

    Raises:
        InvalidInputError: It cannot be read, has no such heading, or a row is malformed; names the line.
    """
    rows = csv.reader(read_text(file, "boxes", _FIX).splitlines())
    heading = [name.strip().lower().replace(" ", "_").replace("-", "_") for name in next(rows, [])]
    boxes = next((names for names in (*_CORNERS, *_SIDES) if set(names) <= set(heading)), None)
    if boxes is None:
        raise InvalidInputError(f"{file}:1", ",".join(heading)[:80], _FIX)
    found = []
    for row in rows:
        if any(cell.strip() for cell in row):
            try:
                found.append(_box(dict(zip(heading, row, strict=False)), boxes))
            except (ValueError, KeyError) as error:
                raise InvalidInputError(f"{file}:{rows.line_num}", ",".join(row)[:80], _FIX) from error
    return found


def _box(cells: Mapping[str, str], names: Sequence[str]) -> CsvBox:
    """A row by its cells."""
    numbers = np.array([float(cells[name]) for name in names])
    corners = numbers if names in _CORNERS else np.concatenate([numbers[:2], numbers[:2] + numbers[2:]])
    if not np.isfinite(numbers).all() or (corners[2:] <= corners[:2]).any():
        raise ValueError(numbers)
    sizes = ("width", "height") if names in _CORNERS and {"width", "height"} <= cells.keys() else _SIZES
    size = tuple(round(float(cells[name])) for name in sizes if cells.get(name, "").strip())
    score, track = _named(cells, _SCORE), _named(cells, _TRACK)
    number = None if track in (None, "None", "nan") else int(float(track or 0))
    return CsvBox(
        corners,
        _named(cells, _KIND) or "car",
        _named(cells, _IMAGE),
        None if score is None else float(score),
        None if number is None or number < 0 else number,
        (size[0], size[1]) if len(size) == 2 else None,
    )


def _named(cells: Mapping[str, str], names: Sequence[str]) -> str | None:
    """What is in the first of some columns that a row has, or None."""
    return next((text for name in names if (text := cells.get(name, "").strip())), None)
