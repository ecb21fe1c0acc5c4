"""2D boxes of the cars in an image from files that detectors and data sets write."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import takewhile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.errors import InvalidInputError
from fgrecon.core.options import BoxModel
from fgrecon.io.files import read_text
from fgrecon.io.json_fields import Fields, read_json
from fgrecon.io.kitti_files import DETECTION_CLASSES, LABEL_COLUMNS, parse_detection, parse_object
from fgrecon.io.nuscenes import cuboid_boxes, is_nuscenes, open_nuscenes

__all__ = ["LEAST_SCORE", "NamedBox", "read_boxes"]

_COCO_CAR = 3  # COCO's number of cars, where the file names no categories
_YOLO_CAR = 2  # the place of cars among COCO's 80 classes, as which YOLO numbers them
_YOLO_COLUMNS = 5
LEAST_SCORE = 0.5
"""Boxes of a lower score are left out where nothing else is said."""
_CLASSES = "classes.txt"
_FIX = (
    "Give KITTI labels (object, tracking), detections `image class score x1 y1 x2 y2`, YOLO's `class x y w h`, COCO "
    "JSON, or nuScenes' tables. MOT's lines are of a video: `fgrecon run --tracks`."
)


@dataclass(frozen=True)
class NamedBox:
    """A car's box.

    Attributes:
        name: Its id.
        corners: (4,) x1, y1, x2, y2 in pixels.
        model: What it encloses.
        score: Of its detector, or None.
        track: Id that a tracker gave it, or None.
    """

    name: str
    corners: NDArray[np.float64]
    model: BoxModel
    score: float | None = None
    track: int | None = None


def read_boxes(
    file: Path, image: str, size: tuple[int, int] | None = None, least_score: float | None = None
) -> list[NamedBox]:
    """The cars of an image in a file.

    KITTI's boxes enclose the projected 3D box, and so do those of detectors trained on them and nuScenes' projected
    cuboids; those of COCO and YOLO the outline. Lines of detections may say it themselves.

    Args:
        file: KITTI label or result file (object or tracking, type `Car`), detections with lines
            `image class score x1 y1 x2 y2 [box model]`, YOLO's lines `class x y w h [score] [track]` in parts of the
            image (cars are class 2, or the line `car` of a `classes.txt` beside the file), COCO JSON, the folder of
            nuScenes' tables; or a folder with such a file for each image, of its name.
        image: Name of the image, without ending. Folders before it choose among images of that name (COCO).
        size: Width and height of the image, pixels, which YOLO's boxes need.
        least_score: Boxes of a lower score are left out; None for 0.5, and all of KITTI's results, whose scores are
            of any scale.

    Raises:
        InvalidInputError: The file cannot be read or has another format, or several of its images may be meant; names
            line or field.
    """
    given = Path(image)
    image = given.name
    if is_nuscenes(file):
        found = cuboid_boxes(open_nuscenes(file), image, "vehicle.car")
        return [NamedBox(token, corners, BoxModel.CUBOID) for token, corners in found]
    if file.is_dir():
        file = next((path for ending in (".txt", ".json") if (path := file / f"{image}{ending}").is_file()), file)
    if file.suffix.lower() == ".json":
        return _coco(read_json(file), file, given, LEAST_SCORE if least_score is None else least_score)
    boxes: list[NamedBox] = []
    for number, line in enumerate(read_text(file, "boxes", _FIX).splitlines()):
        if not line.strip():
            continue
        try:
            relative = _relative(line.split())
            box = _of_line(line.split(), line, image) if relative is None else None
        except ValueError as error:
            raise InvalidInputError(f"{file}:{number + 1}", line, _FIX) from error
        if relative is not None:
            box = relative.in_image(file, number, size)
        if box is not None and not box.below(least_score):
            boxes.append(
                NamedBox(str(number if box.named else len(boxes)), box.corners, box.model, box.score, box.track)
            )
    return boxes


@dataclass(frozen=True)
class _Box:
    """A box in pixels: what it encloses, whether its line is its name, its score, and whether scores end at 1."""

    corners: NDArray[np.float64]
    model: BoxModel
    named: bool
    score: float | None
    unit: bool = True
    track: int | None = None

    def below(self, least: float | None) -> bool:
        """Whether its score is lower than is allowed."""
        if self.score is None or (least is None and not self.unit):
            return False
        return self.score < (LEAST_SCORE if least is None else least)


@dataclass(frozen=True)
class _Relative:
    """A line of YOLO's: number of the class, centre and size of the box in parts of the image, score, track."""

    kind: int
    box: NDArray[np.float64]
    score: float | None
    track: int | None

    def in_image(self, file: Path, number: int, size: tuple[int, int] | None) -> _Box | None:
        """The box in pixels; None where it is of no car."""
        if size is None:
            raise InvalidInputError(f"{file}:{number + 1}", "a box in parts of the image", "Give the image's size.")
        if self.kind != _car_class(file):
            return None
        centre, half = self.box[:2] * size, self.box[2:] * size / 2
        corners = np.concatenate([centre - half, centre + half])
        return _Box(corners, BoxModel.SURFACE, named=True, score=self.score, track=self.track)


def _relative(words: list[str]) -> _Relative | None:
    """A line of YOLO's, `class x y w h` and behind it a score, the whole number of a track, or both; None: it is none.

    Raises:
        ValueError: A number is out of range.
    """
    more = len(words) - _YOLO_COLUMNS
    if not (words[0].isdecimal() and 0 <= more <= 2):
        return None
    track = int(words[-1]) if more and words[-1].isdecimal() else None
    numbers = np.array(words[1:] if track is None else words[1:-1], dtype=np.float64)
    if len(numbers) > _YOLO_COLUMNS or not ((numbers >= 0) & (numbers <= 1)).all():
        if more == 2 and words[1].isdecimal():  # a line of detections, which has as many columns
            return None
        raise ValueError("parts of the image are from 0 to 1, and a track is a whole number")
    return _Relative(int(words[0]), numbers[:4], float(numbers[4]) if len(numbers) == _YOLO_COLUMNS else None, track)


def _of_line(words: list[str], line: str, image: str) -> _Box | None:
    """The box of a line of KITTI's or of detections, or None where it is of no car of this image.

    Raises:
        ValueError: The line has no known format.
    """
    columns = len(words)
    if columns in (LABEL_COLUMNS + 2, LABEL_COLUMNS + 3) and words[0].isdecimal() and _is_integer(words[1]):
        if not image.isdecimal() or words[0].lstrip("0") != image.lstrip("0"):
            return None
        columns, line = columns - 2, " ".join(words[2:])
    if columns in (LABEL_COLUMNS, LABEL_COLUMNS + 1):
        scored = columns > LABEL_COLUMNS
        kind, numbers = parse_object(line, scored=scored)
        score = numbers[-1] if scored else None
        box = _Box(np.array(numbers[3:7]), BoxModel.CUBOID, named=True, score=score, unit=False)
        return box if kind == "Car" else None
    found = parse_detection(line)
    if DETECTION_CLASSES.get(found.label) != "Car" or Path(found.image).stem != image:
        return None
    return _Box(np.array(found.box), found.model or BoxModel.CUBOID, named=False, score=found.score)


def _is_integer(word: str) -> bool:
    """Tracks of KITTI's DontCare regions are -1."""
    return word.removeprefix("-").isdecimal()


def _car_class(file: Path) -> int:
    """Number of YOLO's class of cars: the line `car` of `classes.txt`, where that lies beside the file."""
    names = file.parent / _CLASSES
    if not names.exists():
        return _YOLO_CAR
    lines = [
        line.strip() for line in read_text(names, "boxes", "Give the names of the classes, one a line.").splitlines()
    ]
    if "car" not in lines:
        raise InvalidInputError(str(names), ", ".join(lines), "Let a line be `car`.")
    return lines.index("car")


def _coco(data: Any, file: Path, image: Path, least_score: float) -> list[NamedBox]:
    """COCO's results (a list) or annotations (an object with images, categories and annotations), crowds left out."""
    cars: list[Any] = [_COCO_CAR]
    ids: list[Any] = [image.name]
    entries = data
    if isinstance(data, Mapping):
        fields = Fields(data, f"{file}: ")
        entries = fields.get("annotations", list)
        if "categories" in fields:
            cars = [c["id"] for c in _entries(fields, "categories") if c.get("name") == "car" and "id" in c]
        pictures = _entries(fields, "images") if "images" in fields else []
        ids = _of_image(pictures, image, file)
    elif image.name.isdecimal():
        ids.append(int(image.name))
    if not isinstance(entries, list):
        raise InvalidInputError(str(file), type(entries).__name__, _FIX)
    boxes = []
    for number, entry in enumerate(entries):
        fields = Fields(entry, f"{file}: [{number}].")
        if fields.data.get("image_id") not in ids or fields.data.get("category_id") not in cars:
            continue
        if fields.data.get("iscrowd") == 1:
            continue
        if "score" in fields and float(fields.numbers("score", ())) < least_score:
            continue
        x, y, width, height = fields.numbers("bbox", (4,))
        boxes.append(NamedBox(str(number), np.array([x, y, x + width, y + height]), BoxModel.SURFACE))
    return boxes


def _of_image(pictures: Sequence[Mapping[str, Any]], image: Path, file: Path) -> list[Any]:
    """Ids of the image of a name: of several, of the one whose folders are most like the given.

    Raises:
        InvalidInputError: There are several such.
    """
    found = [(Path(str(one.get("file_name"))), one["id"]) for one in pictures if "id" in one]
    alike = [(_alike(path.parent, image.parent), path, number) for path, number in found if path.stem == image.name]
    most = max((shared for shared, _, _ in alike), default=0)
    best = [(path, number) for shared, path, number in alike if shared == most]
    if len(paths := {path.as_posix() for path, _ in best}) > 1:
        value = f"{image.name}, which is {' and '.join(sorted(paths)[:2])}"
        raise InvalidInputError(f"{file}: image", value, "Give boxes of one of them, or the image by its folder.")
    return [number for _, number in best]


def _alike(folder: Path, other: Path) -> int:
    """How many of their last parts two folders share."""
    pairs = zip(reversed(folder.parts), reversed(other.parts), strict=False)
    return len(list(takewhile(lambda pair: pair[0] == pair[1], pairs)))


def _entries(fields: Fields, name: str) -> list[Mapping[str, Any]]:
    return [Fields(item, f"{fields.where}{name}[{i}].").data for i, item in enumerate(fields.get(name, list))]
