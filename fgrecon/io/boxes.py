"""2D boxes of the cars in an image from files that detectors and data sets write."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import takewhile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.errors import InvalidInputError
from fgrecon.core.options import BoxModel
from fgrecon.io.files import read_text
from fgrecon.io.frame_names import of_one_image
from fgrecon.io.image_size import scale_between
from fgrecon.io.json_fields import Fields, plain_id, read_json
from fgrecon.io.kitti_files import DETECTION_CLASSES, LABEL_COLUMNS, parse_detection, parse_object
from fgrecon.io.lens_fields import read_size
from fgrecon.io.nuscenes import NEAREST, cuboid_boxes, is_nuscenes, open_nuscenes

_YOLO_COLUMNS = 5
LEAST_SCORE = 0.5
"""Boxes of a lower score are left out where nothing else is said."""
_CAR = "car"
_COCO_CLASSES = {1: "person", 2: "bicycle", 3: "car", 4: "motorcycle", 6: "bus", 7: "train", 8: "truck"}
"""COCO's numbers of classes, where the file names no categories."""
_YOLO_CLASSES = {0: "person", 1: "bicycle", 2: "car", 3: "motorcycle", 5: "bus", 6: "train", 7: "truck"}
"""The places of these among COCO's 80 classes, as which YOLO numbers them."""
_OTHER_VEHICLES = frozenset(["van", "truck", "bus", "train", "tram", "trailer", "motorcycle", "motorbike", "caravan"])
_CLASSES = "classes.txt"
_LISTED = 5  # classes and images that an error names
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
        kind: Its class as the file has it, one word such as `car`; or None.
    """

    name: str
    corners: NDArray[np.float64]
    model: BoxModel
    score: float | None = None
    track: int | None = None
    kind: str | None = None


@dataclass(frozen=True)
class FileBoxes:
    """What a file has for an image.

    Attributes:
        cars: The boxes that are taken.
        low: How many cars were left out for their score.
        crowds: How many boxes were left out as crowds.
        classes: How many boxes of the image are of which other class.
        images: How many boxes are of which other image.
        near: How many cars of nuScenes reach nearer to the camera than its near plane, and have no 2D box.
    """

    cars: list[NamedBox]
    low: int = 0
    crowds: int = 0
    classes: Counter[str] = field(default_factory=Counter)
    images: Counter[str] = field(default_factory=Counter)
    near: int = 0

    @property
    def other_vehicles(self) -> Counter[str]:
        """How many vehicles of the image are no cars, by their class."""
        return Counter({kind: count for kind, count in self.classes.items() if kind.lower() in _OTHER_VEHICLES})

    @property
    def left_out(self) -> str:
        """How many boxes were left out, by reason."""
        reasons = {
            f"with a score below what is taken ({LEAST_SCORE} where nothing is said)": self.low,
            "of crowds": self.crowds,
            f"of other classes ({_some(self.classes)})": self.classes.total(),
            f"of other images ({_some(self.images)})": self.images.total(),
            f"nearer to the camera than {NEAREST} m, which have no 2D box": self.near,
        }
        said = [f"{count} {reason}" for reason, count in reasons.items() if count]
        return f"left out: {', '.join(said)}" if said else "it has no box at all"


def _some(names: Counter[str]) -> str:
    """Some names with their counts."""
    listed = ", ".join(names if len(names) <= _LISTED else [*list(names)[:_LISTED], "..."])
    return listed if len(listed) <= 200 else f"{listed[:200]}..."


def read_boxes(
    file: Path,
    image: str,
    size: tuple[int, int] | None = None,
    least_score: float | None = None,
    *,
    scale_to_image: bool = False,
) -> list[NamedBox]:
    """The cars of an image in a file; see `boxes_in`."""
    return boxes_in(file, image, size, least_score, scale_to_image=scale_to_image).cars


def boxes_in(
    file: Path,
    image: str,
    size: tuple[int, int] | None = None,
    least_score: float | None = None,
    *,
    scale_to_image: bool = False,
) -> FileBoxes:
    """The cars of an image in a file, and what else it has.

    KITTI's boxes enclose the projected 3D box, and so do those of detectors trained on them and nuScenes' projected
    cuboids; those of COCO and YOLO the outline. Lines of detections may say it themselves. Names of classes are taken
    without regard to capitals, ids 1, 1.0 and "1" alike, names of images with their ending or without.

    Args:
        file: KITTI label or result file (object or tracking, type `Car`), detections with lines
            `image class score x1 y1 x2 y2 [box model]`, YOLO's lines `class x y w h [score] [track]` in parts of the
            image (cars are class 2, or the line `car` of a `classes.txt` beside the file), COCO JSON, the folder of
            nuScenes' tables; or a folder with such a file for each image, of its name.
        image: Name of the image, without ending. Folders before it choose among images of that name (COCO).
        size: Width and height of the image, pixels, which YOLO's boxes need.
        least_score: Boxes of a lower score are left out; None for 0.5, and all of KITTI's results, whose scores are
            of any scale.
        scale_to_image: Whether boxes are scaled to the image where the file has a size of the same shape for it.

    Raises:
        InvalidInputError: The file cannot be read or has another format, several of its images may be meant, or it
            states another size of the image; names line or field.
    """
    given = Path(image)
    image = given.name
    if is_nuscenes(file):
        cuboids, near = cuboid_boxes(open_nuscenes(file), image, "vehicle.car")
        cars = [NamedBox(token, corners, BoxModel.CUBOID, kind=_CAR) for token, corners in cuboids]
        return FileBoxes(cars, near=near)
    if file.is_dir():
        file = next((path for ending in (".txt", ".json") if (path := file / f"{image}{ending}").is_file()), file)
    if file.suffix.lower() == ".json":
        coco = _Coco.of(read_json(file), file, LEAST_SCORE if least_score is None else least_score)
        return coco.of_image(given, size, scale=scale_to_image)
    return _of_lines(file, image, size, least_score)


def _of_lines(file: Path, image: str, size: tuple[int, int] | None, least_score: float | None) -> FileBoxes:
    """The boxes of a file of lines."""
    rows: list[tuple[int, _Box]] = []
    for number, line in enumerate(read_text(file, "boxes", _FIX).splitlines()):
        if not line.strip():
            continue
        try:
            relative = _relative(line.split())
            box = _of_line(line.split(), line) if relative is None else None
        except ValueError as error:
            raise InvalidInputError(f"{file}:{number + 1}", line, _FIX) from error
        box = relative.in_image(file, number, size) if relative is not None else box
        assert box is not None
        rows.append((number, box))
    same = of_one_image((box.image for _, box in rows if box.image is not None), image)
    found = FileBoxes([])
    low = 0
    for number, box in rows:
        if box.image is not None and box.image not in same:
            found.images[box.image] += 1
        elif box.kind.lower() != _CAR:
            found.classes[box.kind] += 1
        elif box.below(least_score):
            low += 1
        else:
            name = str(number if box.named else len(found.cars))
            found.cars.append(NamedBox(name, box.corners, box.model, box.score, box.track, box.kind))
    return replace(found, low=low)


@dataclass(frozen=True)
class _Box:
    """The box of a line in pixels.

    Attributes:
        corners: (4,) x1, y1, x2, y2.
        model: What it encloses.
        kind: Its class.
        named: Whether its line is its name.
        score: Or None.
        image: Name of its image, or None where its file has only one.
        unit: Whether scores end at 1.
        track: Or None.
    """

    corners: NDArray[np.float64]
    model: BoxModel
    kind: str
    named: bool
    score: float | None
    image: str | None = None
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

    def in_image(self, file: Path, number: int, size: tuple[int, int] | None) -> _Box:
        """The box in pixels."""
        if size is None:
            raise InvalidInputError(f"{file}:{number + 1}", "a box in parts of the image", "Give the image's size.")
        centre, half = self.box[:2] * size, self.box[2:] * size / 2
        corners = np.concatenate([centre - half, centre + half])
        kind = _yolo_class(file, self.kind)
        return _Box(corners, BoxModel.SURFACE, kind, named=True, score=self.score, track=self.track)


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


def _of_line(words: list[str], line: str) -> _Box:
    """The box of a line of KITTI's or of detections.

    Raises:
        ValueError: The line has no known format.
    """
    columns = len(words)
    image = track = None
    if columns in (LABEL_COLUMNS + 2, LABEL_COLUMNS + 3) and words[0].isdecimal() and _is_integer(words[1]):
        image, track = words[0], int(words[1]) if words[1].isdecimal() else None
        columns, line = columns - 2, " ".join(words[2:])
    if columns in (LABEL_COLUMNS, LABEL_COLUMNS + 1):
        scored = columns > LABEL_COLUMNS
        kind, numbers = parse_object(line, scored=scored)
        score = numbers[-1] if scored else None
        box = np.array(numbers[3:7])
        return _Box(box, BoxModel.CUBOID, kind, named=True, score=score, image=image, unit=False, track=track)
    found = parse_detection(line)
    kind = DETECTION_CLASSES.get(found.label, f"{found.label}")
    model = found.model or BoxModel.CUBOID
    return _Box(np.array(found.box), model, kind, named=False, score=found.score, image=found.image)


def _is_integer(word: str) -> bool:
    """Tracks of KITTI's DontCare regions are -1."""
    return word.removeprefix("-").isdecimal()


def _yolo_class(file: Path, number: int) -> str:
    """Name of a class of YOLO's, by `classes.txt` where that is beside the file; its number where it has none."""
    names = file.parent / _CLASSES
    if not names.exists():
        return _YOLO_CLASSES.get(number, str(number))
    lines = [
        line.strip() for line in read_text(names, "boxes", "Give the names of the classes, one a line.").splitlines()
    ]
    if _CAR not in map(str.lower, lines):
        raise InvalidInputError(str(names), ", ".join(lines), "Let a line be `car`.")
    return _word(lines[number]) if number < len(lines) else str(number)


def _word(name: object) -> str:
    """A class as one word."""
    return "_".join(str(name).split())


@dataclass(frozen=True)
class _Coco:
    """COCO's results (a list) or annotations (an object with images, categories and annotations).

    Attributes:
        file: The file.
        entries: The boxes.
        pictures: The images that it lists; None where it is a list of results.
        kinds: Names of the classes by their ids; None where it has none.
        least_score: Boxes of a lower score are left out.
    """

    file: Path
    entries: list[Any]
    pictures: Sequence[Mapping[str, Any]] | None
    kinds: Mapping[int | str | None, str] | None
    least_score: float

    @classmethod
    def of(cls, data: Any, file: Path, least_score: float) -> _Coco:
        """The content of a file."""
        entries, pictures, kinds = data, None, None
        if isinstance(data, Mapping):
            fields = Fields(data, f"{file}: ")
            entries = fields.get("annotations", list)
            if "categories" in fields:
                kinds = {plain_id(c["id"]): _word(c.get("name")) for c in _entries(fields, "categories") if "id" in c}
            pictures = _entries(fields, "images") if "images" in fields else []
        if not isinstance(entries, list):
            raise InvalidInputError(str(file), type(entries).__name__, _FIX)
        return cls(file, entries, pictures, kinds, least_score)

    def of_image(self, image: Path, size: tuple[int, int] | None, *, scale: bool) -> FileBoxes:
        """The boxes of an image."""
        ids, ratio = self._ids(image), np.ones(4)
        for number, picture in enumerate(self.pictures or ()):
            if plain_id(picture.get("id")) in ids:
                stated = read_size(Fields(picture, f"{self.file}: images[{number}]."))
                ratio = np.tile(scale_between(stated, size, f"{self.file}: images[{number}]", scale=scale), 2)
        found, low, crowds = FileBoxes([]), 0, 0
        for number, entry in enumerate(self.entries):
            fields = Fields(entry, f"{self.file}: [{number}].")
            place, kind = plain_id(fields.data.get("image_id")), self._kind(fields)
            if place not in ids:
                found.images[self._name(place)] += 1
            elif kind.lower() != _CAR:
                found.classes[kind] += 1
            elif fields.data.get("iscrowd") == 1:
                crowds += 1
            else:
                score = float(fields.numbers("score", ())) if "score" in fields else None
                if score is not None and score < self.least_score:
                    low += 1
                    continue
                x, y, width, height = fields.numbers("bbox", (4,))
                corners = np.array([x, y, x + width, y + height]) * ratio
                track = plain_id(fields.data.get("track_id"))
                number_of = track if isinstance(track, int) and track >= 0 else None
                found.cars.append(NamedBox(str(number), corners, BoxModel.SURFACE, score, number_of, kind))
        return replace(found, low=low, crowds=crowds)

    def _ids(self, image: Path) -> set[int | str | None]:
        if self.pictures is not None:
            return {plain_id(number) for number in _of_image(self.pictures, image, self.file)}
        names = {
            place for entry in self.entries if (place := plain_id(Fields(entry, "").data.get("image_id"))) is not None
        }
        same = of_one_image(map(str, names), image.name)
        return {name for name in names if str(name) in same}

    def _kind(self, fields: Fields) -> str:
        """Class of a box; its id where nobody names it."""
        number = plain_id(fields.data.get("category_id"))
        known: Mapping[Any, str] = _COCO_CLASSES if self.kinds is None else self.kinds
        return _word(known.get(number, number))

    def _name(self, place: int | str | None) -> str:
        """An image for an error: its name, or its id."""
        named = [one.get("file_name") for one in self.pictures or () if plain_id(one.get("id")) == place]
        return str(named[0] if named and named[0] else place)


def _of_image(pictures: Sequence[Mapping[str, Any]], image: Path, file: Path) -> list[Any]:
    """Ids of the image of a name: of several, of the one whose folders are most like the given.

    Raises:
        InvalidInputError: There are several such.
    """
    named = [(Path(str(one["file_name"])), one["id"]) for one in pictures if "id" in one and one.get("file_name")]
    same = of_one_image((path.name for path, _ in named), image.name)
    alike = [(_alike(path.parent, image.parent), path, number) for path, number in named if path.name in same]
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
