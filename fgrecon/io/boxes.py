"""2D boxes of the cars in an image from files that detectors and data sets write.

CSV files have a heading, as those of ultralytics, supervision, TensorFlow, VIA-like tools and one's own:

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
from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from itertools import takewhile
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.errors import InvalidInputError
from fgrecon.core.evidence import VehicleClass
from fgrecon.core.options import BoxModel
from fgrecon.core.text import counted, one_word
from fgrecon.io.catalogue import class_of_kind
from fgrecon.io.files import read_text
from fgrecon.io.json_fields import Fields, plain_id, read_json
from fgrecon.io.kitti_files import DETECTION_CLASSES, LABEL_COLUMNS, parse_detection, parse_object
from fgrecon.io.lens_fields import read_size, scale_between
from fgrecon.io.nuscenes import NEAREST, cuboid_boxes, is_nuscenes, open_nuscenes
from fgrecon.io.source_frames import of_one_image

_YOLO_COLUMNS = 5
LEAST_SCORE = 0.5
"""Boxes of a lower score are left out where nothing else is said."""
_CAR = "car"
COCO_CLASSES = {1: "person", 2: "bicycle", 3: "car", 4: "motorcycle", 6: "bus", 7: "train", 8: "truck"}
"""COCO's numbers of classes, where the file names no categories."""
YOLO_CLASSES = {0: "person", 1: "bicycle", 2: "car", 3: "motorcycle", 5: "bus", 6: "train", 7: "truck"}
"""The places of these among COCO's 80 classes, as which YOLO numbers them."""
_OTHER_VEHICLES = frozenset(["van", "truck", "bus", "train", "tram", "trailer", "motorcycle", "motorbike", "caravan"])
_CLASSES, _DATA = "classes.txt", "data.yaml"
ENDINGS = (".txt", ".json", ".csv")
"""Of files of boxes."""
_LISTED = 5  # classes and images that an error names
_FIX = (
    "Give KITTI labels (object, tracking), detections `image class score x1 y1 x2 y2`, YOLO's `class x y w h`, CSV, "
    "COCO JSON, or nuScenes' tables. MOT's lines are of a video: `fgrecon run --tracks`."
)

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
_CSV_FIX = (
    "Give a heading: image, class, score and x1,y1,x2,y2 (or x,y,w,h of the upper left corner), in pixels; of several "
    "images the image's name is needed."
)


@dataclass(frozen=True)
class NamedBox:
    """A car's box."""

    name: str  # its id
    corners: NDArray[np.float64]  # (4,) x1, y1, x2, y2 in pixels
    model: BoxModel  # what it encloses
    score: float | None = None  # of its detector, or None
    track: int | None = None  # id that a tracker gave it, or None
    kind: str | None = None  # its class as the file has it, one word such as `car`; or None
    vehicle_class: VehicleClass | None = None  # the same as evidence of its size; None where nobody says


@dataclass(frozen=True)
class FileBoxes:
    """What a file has for an image."""

    cars: list[NamedBox]  # the boxes that are taken
    low: int = 0  # how many cars were left out for their score
    crowds: int = 0  # how many boxes were left out as crowds
    classes: Counter[str] = field(default_factory=Counter)  # how many boxes of the image are of which other class
    images: Counter[str] = field(default_factory=Counter)  # how many boxes are of which other image
    near: int = 0  # how many cars of nuScenes reach nearer to the camera than its near plane, and have no 2D box
    absent: bool = False  # whether a folder has no file for the image

    @property
    def other_vehicles(self) -> Counter[str]:
        """How many vehicles of the image are no cars, by their class."""
        return Counter({kind: count for kind, count in self.classes.items() if kind.lower() in _OTHER_VEHICLES})

    @property
    def reasons(self) -> dict[str, int]:
        """How many boxes of the image were left out, by reason."""
        reasons = {
            f"with a score below what is taken ({LEAST_SCORE} where nothing is said)": self.low,
            "of crowds": self.crowds,
            f"of other classes ({_some(self.classes)})": self.classes.total(),
            f"nearer to the camera than {NEAREST} m, which have no 2D box": self.near,
        }
        return {reason: count for reason, count in reasons.items() if count}

    def notes(self, category: str) -> tuple[str, ...]:
        """What vehicles of the image were left out: those that a category does not cover, and those too near."""
        listed = ", ".join(f"{count} {kind}" for kind, count in self.other_vehicles.most_common())
        others = (f"left out {listed}, which {category} does not cover.",) if listed else ()
        near = f"left out {counted(self.near, 'car')} nearer to the camera than {NEAREST} m, without a 2D box."
        return (*others, near) if self.near else others

    @property
    def left_out(self) -> str:
        """How many boxes were left out, by reason, those of other images included."""
        others = {f"of other images ({_some(self.images)})": self.images.total()} if self.images else {}
        if self.absent:
            return "the folder has no file for it"
        counts = [f"{count} {reason}" for reason, count in (self.reasons | others).items()]
        return f"left out: {', '.join(counts)}" if counts else "it has no box at all"


def _some(names: Counter[str]) -> str:
    """Some names with their counts."""
    listed = ", ".join(names if len(names) <= _LISTED else [*list(names)[:_LISTED], "..."])
    return listed if len(listed) <= 200 else f"{listed[:200]}..."


def boxes_in(
    file: Path,
    image: str,
    size: tuple[int, int] | None = None,
    least_score: float | None = None,
    *,
    scale_to_image: bool = False,
    all_classes: bool = False,
) -> FileBoxes:
    """The cars of an image in a file, and what else it has.

    KITTI's boxes enclose the projected 3D box, and so do those of detectors trained on them and nuScenes' projected
    cuboids; those of COCO and YOLO the outline. Lines of detections may say it themselves. Names of classes are taken
    without regard to capitals, ids 1, 1.0 and "1" alike, names of images with their ending or without.

    Args:
        file: KITTI label or result file (object or tracking, type `Car`), detections with lines
            `image class score x1 y1 x2 y2 [box model]`, CSV with a heading, YOLO's lines
            `class x y w h [score] [track]` in parts of the image (cars are class 2, or `car` in a `classes.txt` beside
            the file or a `data.yaml` above it), COCO JSON, the folder of nuScenes' tables; or a folder with such a file
            for each image, of its name.
        image: Name of the image, without ending. Folders before it choose among images of that name (COCO).
        size: Width and height of the image, pixels, which YOLO's boxes need.
        least_score: Boxes of a lower score are left out; None for 0.5, and all of KITTI's results, whose scores are
            of any scale.
        scale_to_image: Whether boxes are scaled to the image where the file has a size of the same shape for it.
        all_classes: Whether vans, lorries, buses and trams are taken as well.

    Raises:
        InvalidInputError: The file cannot be read or has another format, several of its images may be meant, or it
            states another size of the image; names line or field.
    """
    given = Path(image)
    image = given.name
    if is_nuscenes(file):
        return _of_nuscenes(file, image, all_classes=all_classes)
    if file.is_dir():
        own = next((path for ending in ENDINGS if (path := file / f"{image}{ending}").is_file()), None)
        if own is None:
            _check_folder(file)
            return FileBoxes([], absent=True)
        file = own
    if file.suffix.lower() == ".json":
        least = LEAST_SCORE if least_score is None else least_score
        return _coco(file, _changed(file)).of_image(given, size, least, scale=scale_to_image, all_classes=all_classes)
    rows = [
        (number, box.in_image(file, number, size, scale=scale_to_image)) for number, box in _lines(file, _changed(file))
    ]
    return _of_lines(rows, image, least_score, all_classes=all_classes)


def _check_folder(folder: Path) -> None:
    """Refuse a folder without boxes."""
    if not any(path.suffix.lower() in ENDINGS and path.name != _CLASSES for path in folder.iterdir()):
        fix = f"Give the folder with a file ({', '.join(ENDINGS)}) for each image, of its name."
        raise InvalidInputError("boxes", f"{folder} without one", fix)


def names_images(file: Path) -> bool:
    """Whether a file or folder of boxes tells those of several images apart."""
    if file.is_dir() or file.suffix.lower() == ".json":
        return True
    rows = _lines(file, _changed(file))
    return any(not isinstance(box, _Relative) and box.image is not None for _, box in rows)


def _changed(file: Path) -> int:
    """When a file was changed; what was read of it before holds until then."""
    try:
        return file.stat().st_mtime_ns
    except OSError:
        raise InvalidInputError("boxes", str(file), _FIX) from None


@lru_cache(maxsize=2)
def _lines(file: Path, changed: int) -> tuple[tuple[int, _Box | _Relative], ...]:  # noqa: ARG001
    """The boxes of a file of lines or of a CSV, with their numbers; a changed file is read again."""
    if file.suffix.lower() == ".csv":
        return tuple(enumerate(_of_csv(file)))
    rows: list[tuple[int, _Box | _Relative]] = []
    for number, line in enumerate(read_text(file, "boxes", _FIX).splitlines()):
        if not line.strip():
            continue
        try:
            rows.append((number, _relative(line.split()) or _of_line(line.split(), line)))
        except ValueError as error:
            raise InvalidInputError(f"{file}:{number + 1}", line, _FIX) from error
    return tuple(rows)


def _taken(kind: str, *, all_classes: bool) -> bool:
    """Whether boxes of a class are."""
    return kind.lower() == _CAR or (all_classes and class_of_kind(kind) is not None)


def _of_nuscenes(file: Path, image: str, *, all_classes: bool) -> FileBoxes:
    """The boxes of an image by nuScenes' tables."""
    found = FileBoxes([])
    for one in cuboid_boxes(open_nuscenes(file), image):
        known, kind = class_of_kind(one.category), one.category.split(".")[:2][-1]  # vehicle.car, vehicle.bus.rigid
        if not (kind == _CAR or (all_classes and known is not None)):
            found.classes[kind] += one.corners is not None
        elif one.corners is None:
            found = replace(found, near=found.near + 1)
        else:
            found.cars.append(NamedBox(one.token, one.corners, BoxModel.CUBOID, kind=kind, vehicle_class=known))
    return found


def _of_lines(
    rows: Sequence[tuple[int, _Box]], image: str, least_score: float | None, *, all_classes: bool
) -> FileBoxes:
    """The cars of an image among the boxes of lines."""
    same = of_one_image((box.image for _, box in rows if box.image is not None), image)
    found = FileBoxes([])
    low = 0
    for number, box in rows:
        if box.image is not None and box.image not in same:
            found.images[box.image] += 1
        elif not _taken(box.kind, all_classes=all_classes):
            found.classes[box.kind] += 1
        elif box.below(least_score):
            low += 1
        else:
            name = str(number if box.named else len(found.cars))
            known = class_of_kind(box.kind)
            found.cars.append(NamedBox(name, box.corners, box.model, box.score, box.track, box.kind, known))
    return replace(found, low=low)


@dataclass(frozen=True)
class _Box:
    """The box of a line in pixels."""

    corners: NDArray[np.float64]  # (4,) x1, y1, x2, y2
    model: BoxModel  # what it encloses
    kind: str  # its class
    named: bool  # whether its line is its name
    score: float | None  # or None
    image: str | None = None  # name of its image, or None where its file has only one
    unit: bool = True  # whether scores end at 1
    track: int | None = None  # or None
    size: tuple[int, int] | None = None  # of the image as the file states it, or None

    def in_image(self, file: Path, number: int, size: tuple[int, int] | None, *, scale: bool = False) -> _Box:
        """The box in pixels of an image of a size."""
        ratio = np.tile(scale_between(self.size, size, f"{file}: box {number}", scale=scale), 2)
        return self if self.size is None else replace(self, corners=self.corners * ratio)

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

    def in_image(self, file: Path, number: int, size: tuple[int, int] | None, *, scale: bool = False) -> _Box:  # noqa: ARG002
        """The box in pixels."""
        if size is None:
            raise InvalidInputError(f"{file}:{number + 1}", "a box in parts of the image", "Give the image's size.")
        centre, half = self.box[:2] * size, self.box[2:] * size / 2
        corners = np.concatenate([centre - half, centre + half])
        kind = _yolo_class(file, self.kind)
        return _Box(corners, BoxModel.SURFACE, kind, named=True, score=self.score, track=self.track)


def _relative(words: list[str]) -> _Relative | None:
    """A line of YOLO's, `class x y w h` and behind it a score, the whole number of a track, or both; else None."""
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
    """The box of a line of KITTI's or of detections."""
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


def _of_csv(file: Path) -> Iterator[_Box]:
    """The boxes of a CSV file; an error names the line."""
    rows = csv.reader(read_text(file, "boxes", _CSV_FIX).splitlines())
    heading = [name.strip().lower().replace(" ", "_").replace("-", "_") for name in next(rows, [])]
    names = next((names for names in (*_CORNERS, *_SIDES) if set(names) <= set(heading)), None)
    if names is None:
        raise InvalidInputError(f"{file}:1", ",".join(heading)[:80], _CSV_FIX)
    for row in rows:
        if any(cell.strip() for cell in row):
            try:
                box = _of_cells(dict(zip(heading, row, strict=False)), names)
            except (ValueError, KeyError) as error:
                raise InvalidInputError(f"{file}:{rows.line_num}", ",".join(row)[:80], _CSV_FIX) from error
            kind = _yolo_class(file, int(box.kind)) if box.kind.isdecimal() else one_word(box.kind)
            yield replace(box, kind=kind)


def _of_cells(cells: Mapping[str, str], names: Sequence[str]) -> _Box:
    """The box of a row of a CSV file, with its class as it is written; names are those of the box's columns."""
    numbers = np.array([float(cells[name]) for name in names])
    corners = numbers if names in _CORNERS else np.concatenate([numbers[:2], numbers[:2] + numbers[2:]])
    if not np.isfinite(numbers).all() or (corners[2:] <= corners[:2]).any():
        raise ValueError(numbers)
    sizes = ("width", "height") if names in _CORNERS and {"width", "height"} <= cells.keys() else _SIZES
    size = tuple(round(float(cells[name])) for name in sizes if cells.get(name, "").strip())
    score, track = _named(cells, _SCORE), _named(cells, _TRACK)
    number = None if track in (None, "None", "nan") else int(float(track or 0))
    return _Box(
        corners,
        BoxModel.SURFACE,
        _named(cells, _KIND) or _CAR,
        named=True,
        score=None if score is None else float(score),
        image=_named(cells, _IMAGE),
        track=None if number is None or number < 0 else number,
        size=(size[0], size[1]) if len(size) == 2 else None,
    )


def _named(cells: Mapping[str, str], names: Sequence[str]) -> str | None:
    """What is in the first of some columns that a row has, or None."""
    return next((text for name in names if (text := cells.get(name, "").strip())), None)


def _is_integer(word: str) -> bool:
    """Tracks of KITTI's DontCare regions are -1."""
    return word.removeprefix("-").isdecimal()


def _yolo_class(file: Path, number: int) -> str:
    """Name of a class of YOLO's: by `classes.txt` beside the file or `data.yaml` above it, else as COCO's have it."""
    names = _class_names(file.parent)
    return (YOLO_CLASSES if names is None else names).get(number, str(number))


def _class_names(folder: Path) -> Mapping[int, str] | None:
    """Names of the classes by their numbers; None where no file says them."""
    places = (folder / _CLASSES, *(above / _DATA for above in (folder, *folder.absolute().parents[:2])))
    file = next((path for path in places if path.is_file()), None)
    return None if file is None else _names_in(file, _changed(file))


@lru_cache(maxsize=2)
def _names_in(file: Path, changed: int) -> Mapping[int, str]:  # noqa: ARG001
    """The names of classes that a file says; a changed one is read again."""
    text = read_text(file, "boxes", "Give the names of the classes.")
    if file.name == _CLASSES:
        names: Mapping[Any, Any] = dict(enumerate(line.strip() for line in text.splitlines()))
    else:
        names = _named_classes(text)
    if _CAR not in (str(name).lower() for name in names.values()):
        raise InvalidInputError(str(file), ", ".join(map(str, names.values())), "Let a class be `car`.")
    return {int(number): one_word(name) for number, name in names.items() if str(number).isdecimal()}


def _named_classes(text: str) -> Mapping[Any, Any]:
    """The names of ultralytics' description of a data set, a list or by numbers; nothing where it has none."""
    import yaml  # on use: hardly anybody has such a file

    try:
        names = dict(yaml.safe_load(text) or {}).get("names")
    except (yaml.YAMLError, TypeError, ValueError):
        return {}
    return names if isinstance(names, Mapping) else dict(enumerate(names if isinstance(names, list) else []))


@lru_cache(maxsize=2)
def _coco(file: Path, changed: int) -> _Coco:  # noqa: ARG001  # a changed file is read again
    """The content of a file."""
    data = read_json(file)
    entries, pictures, kinds = data, None, None
    if isinstance(data, Mapping):
        fields = Fields(data, f"{file}: ")
        entries = fields.get("annotations", list)
        if "categories" in fields:
            kinds = {
                plain_id(c.data["id"]): one_word(c.data.get("name")) for c in fields.each("categories") if "id" in c
            }
        pictures = [one.data for one in fields.each("images", needed=False)]
    if not isinstance(entries, list):
        raise InvalidInputError(str(file), type(entries).__name__, _FIX)
    by_image: dict[int | str | None, list[tuple[int, Fields]]] = defaultdict(list)
    for number, entry in enumerate(entries):
        record = Fields(entry, f"{file}: [{number}].")
        by_image[plain_id(record.data.get("image_id"))].append((number, record))
    names = {plain_id(one.get("id")): str(one["file_name"]) for one in pictures or () if one.get("file_name")}
    return _Coco(file, by_image, pictures, kinds, names)


@dataclass(frozen=True)
class _Coco:
    """COCO's results (a list) or annotations (an object with images, categories and annotations)."""

    file: Path
    # the boxes with their numbers, by the ids of their images
    entries: Mapping[int | str | None, Sequence[tuple[int, Fields]]]
    pictures: Sequence[Mapping[str, Any]] | None  # the images that it lists; None where it is a list of results
    kinds: Mapping[int | str | None, str] | None  # names of the classes by their ids; None where it has none
    names: Mapping[int | str | None, str]  # of the images by their ids

    def of_image(
        self, image: Path, size: tuple[int, int] | None, least_score: float, *, scale: bool, all_classes: bool
    ) -> FileBoxes:
        """The boxes of an image, those of a lower score left out."""
        ids, ratio = self.ids(image), np.ones(4)
        for number, picture in enumerate(self.pictures or ()):
            if plain_id(picture.get("id")) in ids:
                stated = read_size(Fields(picture, f"{self.file}: images[{number}]."))
                ratio = np.tile(scale_between(stated, size, f"{self.file}: images[{number}]", scale=scale), 2)
        found = FileBoxes([])
        for place, others in self.entries.items():
            found.images[self.names.get(place, str(place))] += 0 if place in ids else len(others)
        low = crowds = 0
        own = (pair for place in ids for pair in self.entries.get(place, ()))
        for number, fields in sorted(own, key=itemgetter(0)):
            kind = self._kind(fields)
            if not _taken(kind, all_classes=all_classes):
                found.classes[kind] += 1
            elif fields.data.get("iscrowd") == 1:
                crowds += 1
            else:
                score = float(fields.numbers("score", ())) if "score" in fields else None
                if score is not None and score < least_score:
                    low += 1
                    continue
                x, y, width, height = fields.numbers("bbox", (4,))
                corners = np.array([x, y, x + width, y + height]) * ratio
                track = plain_id(fields.data.get("track_id"))
                number_of = track if isinstance(track, int) and track >= 0 else None
                known = class_of_kind(kind)
                found.cars.append(NamedBox(str(number), corners, BoxModel.SURFACE, score, number_of, kind, known))
        return replace(found, low=low, crowds=crowds, images=+found.images)

    def ids(self, image: Path) -> set[int | str | None]:
        """Those of an image."""
        if self.pictures is not None:
            return {plain_id(number) for number in _of_image(self.pictures, image, self.file)}
        names = {place for place in self.entries if place is not None}
        same = of_one_image(map(str, names), image.name)
        return {name for name in names if str(name) in same}

    def _kind(self, fields: Fields) -> str:
        """Class of a box; its id where nobody names it."""
        number = plain_id(fields.data.get("category_id"))
        known: Mapping[Any, str] = COCO_CLASSES if self.kinds is None else self.kinds
        return one_word(known.get(number, number))


def coco_entries(file: Path, image: Path) -> list[tuple[Fields, tuple[int, int] | None]]:
    """COCO's annotations or results of an image, each with the size of the image where that is stated.

    Raises:
        InvalidInputError: The file has none, or several of its images may be meant.
    """
    coco = _coco(file, _changed(file))
    ids = coco.ids(image.parent / image.stem)
    pictures = (one for one in coco.pictures or () if plain_id(one.get("id")) in ids)
    size = next((read_size(Fields(one, f"{file}: images.")) for one in pictures), None)
    return [(fields, size) for place in ids for _, fields in coco.entries.get(place, ())]


def _of_image(pictures: Sequence[Mapping[str, Any]], image: Path, file: Path) -> list[Any]:
    """Ids of the image of a name: of several, of the one whose folders are most like the given."""
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
