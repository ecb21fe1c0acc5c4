"""2D boxes of the cars in an image from files that detectors and data sets write."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.errors import InvalidInputError
from fgrecon.core.options import BoxModel
from fgrecon.io.json_fields import Fields, read_json

__all__ = ["NamedBox", "read_boxes"]

_COCO_CAR = 3  # COCO's number of cars, where the file names no categories
_DETECTION_CAR = "2"  # the number of cars in files `image class score x1 y1 x2 y2`
_LABEL_COLUMNS = (15, 16)
_DETECTION_COLUMNS = 7
_LEAST_SCORE = 0.5
_FIX = "Give KITTI labels, detections `image class score x1 y1 x2 y2`, or COCO JSON."


@dataclass(frozen=True)
class NamedBox:
    """A car's box.

    Attributes:
        name: Its id.
        corners: (4,) x1, y1, x2, y2 in pixels.
        model: What it encloses.
    """

    name: str
    corners: NDArray[np.float64]
    model: BoxModel


def read_boxes(file: Path, image: str) -> list[NamedBox]:
    """The cars of an image in a file: of KITTI's labels (type `Car`), of detections with a score from 0.5, of COCO.

    KITTI's boxes enclose the projected 3D box, and so do those of detectors trained on them; COCO's the outline.

    Args:
        file: KITTI label or result file, detections with lines `image class score x1 y1 x2 y2`, or COCO JSON.
        image: Name of the image, without ending.

    Raises:
        InvalidInputError: The file cannot be read or has another format; names line or field.
    """
    if file.suffix.lower() == ".json":
        return _coco(read_json(file), file, image)
    try:
        lines = file.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise InvalidInputError("boxes", str(file), _FIX) from error
    boxes = []
    for number, line in enumerate(lines):
        words = line.split()
        spaced = line.rsplit(maxsplit=_DETECTION_COLUMNS - 1)
        if len(words) not in _LABEL_COLUMNS and len(spaced) == _DETECTION_COLUMNS and spaced[1].isdecimal():
            words = spaced  # of a detection in an image whose name has spaces
        if not words:
            continue
        try:
            if len(words) in _LABEL_COLUMNS:
                if words[0] == "Car":
                    boxes.append(_named(str(number), words[4:8], BoxModel.CUBOID))
            elif len(words) == _DETECTION_COLUMNS:
                if Path(words[0]).stem == image and words[1] == _DETECTION_CAR and float(words[2]) >= _LEAST_SCORE:
                    boxes.append(_named(str(len(boxes)), words[3:], BoxModel.CUBOID))
            else:
                raise ValueError(f"{len(words)} columns")
        except ValueError as error:
            raise InvalidInputError(f"{file}:{number + 1}", line, _FIX) from error
    return boxes


def _named(name: str, numbers: Sequence[Any], model: BoxModel) -> NamedBox:
    corners = np.array([float(number) for number in numbers])
    if not np.isfinite(corners).all():
        raise ValueError("not finite")
    return NamedBox(name, corners, model)


def _coco(data: Any, file: Path, image: str) -> list[NamedBox]:
    """COCO's results (a list) or annotations (an object with images, categories and annotations)."""
    cars: set[Any] = {_COCO_CAR}
    ids: set[Any] = {image}
    entries = data
    if isinstance(data, Mapping):
        fields = Fields(data, f"{file}: ")
        entries = fields.get("annotations", list)
        if "categories" in fields:
            cars = {c.get("id") for c in fields.get("categories", list) if c.get("name") == "car"}
        ids = {i.get("id") for i in data.get("images", []) if Path(str(i.get("file_name"))).stem == image}
    if not isinstance(entries, list):
        raise InvalidInputError(str(file), type(entries).__name__, _FIX)
    if image.isdigit() and not isinstance(data, Mapping):
        ids = {image, int(image)}
    boxes = []
    for number, entry in enumerate(entries):
        fields = Fields(entry, f"{file}: [{number}].")
        if entry.get("image_id") not in ids or entry.get("category_id") not in cars:
            continue
        if entry.get("score", 1.0) < _LEAST_SCORE:
            continue
        x, y, width, height = fields.numbers("bbox", (4,))
        boxes.append(NamedBox(str(number), np.array([x, y, x + width, y + height]), BoxModel.SURFACE))
    return boxes
