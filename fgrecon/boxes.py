"""2D boxes of the cars in an image: given, from files that detectors and data sets write, or detected."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fgrecon.checks import as_finite
from fgrecon.errors import InvalidInputError
from fgrecon.json_fields import Fields, read_json
from fgrecon.keypoints.detect import SMALLEST_BOX
from fgrecon.options import BoxModel

__all__ = ["NamedBox", "boxes_of", "detected_boxes", "read_boxes"]

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


def boxes_of(
    image: Path, given: Sequence[ArrayLike], file: Path | None, search: NDArray[Any] | None = None
) -> list[NamedBox]:
    """The boxes given one by one, those of a file, or those that a detector finds.

    Args:
        image: The image's file, by whose name a file of many images is searched.
        given: Boxes x1, y1, x2, y2 in pixels, of the cars' outlines.
        file: File of boxes, or None.
        search: (H, W, 3) the image's pixels, to be searched for cars; or None.

    Raises:
        InvalidInputError: Several or none of these are given, or there is no car in this image.
    """
    ways = {"--box": bool(given), "--boxes": file is not None, "--detect": search is not None}
    if sum(ways.values()) != 1:
        told = " and ".join(way for way, used in ways.items() if used) or "nothing"
        raise InvalidInputError("box", told, "Give either --box, --boxes with a file, or --detect.")
    if search is not None:
        found = detected_boxes(search)
        if not found:
            raise InvalidInputError("detect", str(image), "No car was found in it; give its box with --box.")
        return found
    if file is None:
        corners = [as_finite(f"box[{number}]", box, (4,)) for number, box in enumerate(given)]
        return [NamedBox(str(number), box, BoxModel.SURFACE) for number, box in enumerate(corners)]
    found = read_boxes(file, image.stem)
    if not found:
        raise InvalidInputError("boxes", str(file), f"Give a file with a car in image {image.stem}.")
    return found


def detected_boxes(image: NDArray[Any]) -> list[NamedBox]:
    """The cars that the detector of the package finds in an image (H, W, 3), by falling score.

    Those under 8 pixels, in which there are no keypoints to be found, are left out.

    Raises:
        InvalidInputError: The image is none, or this installation has no detector.
    """
    from fgrecon.vehicles import VehicleDetector

    boxes = VehicleDetector()(image).boxes
    large = boxes[(boxes[:, 2:] - boxes[:, :2]).max(axis=1) >= SMALLEST_BOX]
    return [NamedBox(str(number), box, BoxModel.SURFACE) for number, box in enumerate(large)]


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
