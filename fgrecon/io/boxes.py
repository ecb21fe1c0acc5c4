"""2D boxes of the cars in an image from files that detectors and data sets write."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.errors import InvalidInputError
from fgrecon.core.options import BoxModel
from fgrecon.io.json_fields import Fields, read_json
from fgrecon.io.kitti_files import DETECTION_CLASSES, LABEL_COLUMNS, parse_detection, parse_object

__all__ = ["NamedBox", "read_boxes"]

_COCO_CAR = 3  # COCO's number of cars, where the file names no categories
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
        if not line.strip():
            continue
        columns = len(line.split())
        try:
            if columns in (LABEL_COLUMNS, LABEL_COLUMNS + 1):
                kind, numbers = parse_object(line, scored=columns > LABEL_COLUMNS)
                if kind == "Car":
                    boxes.append(NamedBox(str(number), np.array(numbers[3:7]), BoxModel.CUBOID))
            else:
                found = parse_detection(line)
                is_car = DETECTION_CLASSES.get(found.label) == "Car" and found.score >= _LEAST_SCORE
                if is_car and Path(found.image).stem == image:
                    boxes.append(NamedBox(str(len(boxes)), np.array(found.box), BoxModel.CUBOID))
        except ValueError as error:
            raise InvalidInputError(f"{file}:{number + 1}", line, _FIX) from error
    return boxes


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
