"""Vehicles of a keypoint file as plain records, one by one: what can be handed to a worker and read there.

A record is an instance in the layout of `fgrecon.io.keypoint_file` with the camera that the file has for all, its
points in the names or the order of whoever wrote it; `parse_any_keypoints` makes an `Instance` of it. Files that are no
JSON are read here: CarFusion's lines, PASCAL3D+'s MATLAB files, one for each image, and lines of YOLO's pose models, a
vehicle each, as labels or as ultralytics' `save_txt` writes them:

    class x y width height u1 v1 c1 u2 v2 c2 ... [score] [track]

Box (its centre) and points are shares of the image, whose size is given by its file: of the same name beside the lines,
or in `images` where they are in `labels`. Points have two numbers, or three: whole ones are COCO's flags, 0 not there,
1 hidden and 2 seen; others are probabilities. A point at the image's corner is none. A lone whole number at the end is
the track: ultralytics writes it without a score by default.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.category import Category
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.observation import Observation
from fgrecon.io.files import filled_lines, read_text
from fgrecon.io.images import IMAGES, read_image
from fgrecon.io.isolated import Isolated
from fgrecon.io.json_fields import read_json
from fgrecon.io.keypoint_file import refuse_results
from fgrecon.io.keypoints.coco_records import annotation_records, is_annotations
from fgrecon.io.keypoints.names import naming_of, scheme_keypoints
from fgrecon.io.keypoints.network_results import PROBABLE, network_instances
from fgrecon.io.keypoints.tool_records import cvat_records, is_tool_file, tool_records

_VISIBLE = 1
"""Status of an anchor: 1 visible, 2 self-occluded, 3 occluded, 4 truncated, 5 unknown."""


@dataclass(frozen=True, eq=False)
class AnchoredObject:
    """One object of a file."""

    anchors: Mapping[str, Any]  # its anchors as MATLAB has them, by name
    box: NDArray[np.float64] | None  # (4,) x1, y1, x2, y2 in 0-based pixels, or None

    def visible(self, where: str) -> dict[str, list[float]]:
        """0-based pixels of the visible anchors, by name; an error begins with a place.

        Raises:
            InvalidInputError: An anchor has no usable location; names it.
        """
        located = {name: _location(f"{where}{name}", anchor) for name, anchor in self.anchors.items()}
        return {name: pixel.tolist() for name, pixel in located.items() if np.isfinite(pixel).all()}


def read_anchors(path: Path, child: Isolated | None = None) -> list[AnchoredObject]:
    """The objects of a file with their anchors, none where an object has none.

    Args:
        child: The process to decode it in, since damaged files can kill SciPy's; None starts one.
    """
    if child is not None:
        return child(str(path), _decode, path)
    with Isolated() as own:
        return own(str(path), _decode, path)


def _decode(path: Path) -> list[AnchoredObject]:
    from scipy.io import loadmat

    fix = "Give a file of PASCAL3D+'s Annotations folder (MATLAB 5 to 7.2 format)."
    try:
        record = loadmat(str(path), squeeze_me=True, struct_as_record=False)["record"]
        objects = np.atleast_1d(record.objects)
    except FileNotFoundError:
        raise InvalidInputError("annotations", str(path), "Give a file that exists.") from None
    except KeyError:
        raise InvalidInputError(f"{path}: record", "no such variable", fix) from None
    except AttributeError:
        raise InvalidInputError(f"{path}: record.objects", "no such field", fix) from None
    except Exception as error:  # SciPy promises no kind of error for damaged content
        raise InvalidInputError(str(path), f"not readable: {error}", fix) from error
    return [AnchoredObject(_named_anchors(item), _box(item)) for item in objects]


def _named_anchors(item: Any) -> dict[str, Any]:
    group = getattr(item, "anchors", None)
    return {name: getattr(group, name) for name in getattr(group, "_fieldnames", [])}


def _box(item: Any) -> NDArray[np.float64] | None:
    """The 2D box, whose pixels MATLAB counts from 1."""
    box = np.asarray(getattr(item, "bbox", ()))
    if box.size != 4 or box.dtype.kind not in "iuf" or not np.isfinite(box).all():
        return None
    return box.astype(np.float64).ravel() - 1.0


def _location(where: str, anchor: Any) -> NDArray[np.float64]:
    """(2,) 0-based pixels, NaN where the anchor is not visible."""
    status = getattr(anchor, "status", None)
    if status is None and not hasattr(anchor, "location"):
        raise InvalidInputError(where, repr(anchor), "Give an anchor with status and location.")
    location = np.asarray(getattr(anchor, "location", ()))
    if status is not None and (np.size(status) != 1 or int(np.ravel(status)[0]) != _VISIBLE):
        return np.full(2, np.nan)
    if location.size == 0 and status is None:
        return np.full(2, np.nan)
    if location.size != 2 or location.dtype.kind not in "iuf" or not np.isfinite(location).all():
        raise InvalidInputError(where, location.tolist(), "Give a visible anchor a location [x y].")
    return location.astype(np.float64).ravel() - 1.0


_CAMERA = ("K", "intrinsics", "distortion", "distortion_model", "image_size")

Record = dict[str, Any]


def is_track(data: Any) -> bool:
    """Whether the content of a JSON file is that of a track, and no labels of several frames."""
    return isinstance(data, Mapping) and "frames" in data and "keypoints" not in data and not is_tool_file(data)


def keypoint_records(path: Path, category: Category) -> list[Any]:
    """The vehicles of a file of any format, or of a track; of COCO's annotations the error where one is malformed.

    Raises:
        InvalidInputError: The file cannot be read, or its frame is malformed; what a record holds is not looked at.
    """
    if path.suffix.lower() in NOT_JSON:
        return [record for record, _ in named_records(path, category)]
    data = read_json(path)
    if is_track(data):
        return _frames(data, path)
    if is_annotations(data):
        return [record for record, _ in annotation_records(data, f"{path}: ")]
    if is_tool_file(data):
        return [record for record, _ in tool_records(data, f"{path}: ")]
    if (found := network_instances(data)) is not None:
        return list(found)
    refuse_results(data, f"{path}: ")
    if not isinstance(data, Mapping) or "instances" not in data:
        return data if isinstance(data, list) else [data]
    if not isinstance(data["instances"], list):
        raise InvalidInputError(f"{path}: instances", data["instances"], "Give a list.")
    shared = {name: data[name] for name in _CAMERA if data.get(name) is not None}
    cameras = {"K", "intrinsics"}
    return [
        {**shared, **item} if isinstance(item, Mapping) and not cameras & {k for k in item if item[k]} else item
        for item in data["instances"]
    ]


def named_records(path: Path, category: Category) -> Iterator[tuple[Record | InvalidInputError, str]]:
    """The vehicles of a file that is no JSON, their points by name, and what errors about each begin with."""
    return _READERS[path.suffix.lower()](path, category)


def _anchors(path: Path, category: Category) -> Iterator[tuple[Record, str]]:
    """Objects of a PASCAL3D+ file that have an anchor of a known name."""
    for number, item in enumerate(read_anchors(path), start=1):
        where = f"{path}: object {number}: "
        found = item.visible(where)
        if found and naming_of(tuple(item.anchors), category) is not None:
            box = {} if item.box is None else {"box": item.box.tolist()}
            yield {"id": number, "image": f"{path.stem}.jpg", "keypoints": found, **box}, where


def _frames(track: Mapping[str, Any], path: Path) -> list[Record]:
    """The frames of a track as instances."""
    try:
        names = track["keypoint_names"]
        return [
            {
                "id": f"{path.stem}:{frame['frame']}",
                "K": track["K"],
                "box": frame["box_xyxy"],
                "keypoints": dict(zip(names, frame["keypoints_uv"], strict=True)),
                "confidence": dict(zip(names, frame["confidence"], strict=True)),
            }
            for frame in track["frames"]
        ]
    except (KeyError, TypeError, ValueError) as error:
        raise InvalidInputError(
            str(path), f"malformed: {error!r}", "Give a track as docs/reference/formats.md has it."
        ) from error


_COLUMNS = 5
_CONFIDENCE = {1.0: 1.0, 2.0: Observation.confidence_midpoint, 3.0: 1.0}


def carfusion_records(path: Path) -> Iterator[tuple[dict[str, Any], str]]:
    """Instances of one file in the layout of a keypoint file, and what errors about each begin with.

    Points at or beyond the image's upper and left edge are CarFusion's for "outside", and left out.
    """
    order = scheme_keypoints("carfusion")
    cars: dict[int, dict[str, list[float]]] = {}
    for place, line in filled_lines(path, "file"):
        u, v, keypoint, car, visibility = _numbers(line, place, len(order))
        points = cars.setdefault(int(car), {})
        if u > 0 and v > 0:
            points[order[int(keypoint) - 1]] = [u, v, _CONFIDENCE[visibility]]
    if not any(cars.values()):
        raise InvalidInputError(str(path), "no point", "Give a file with at least one car.")
    for car, points in cars.items():
        if points:
            yield {"id": car, "image": f"{path.stem}.jpg", "keypoints": points}, f"{path}: car {car}: "


def _numbers(line: str, where: str, count: int) -> list[float]:
    try:
        values = [float(part) for part in line.split(",")]
    except ValueError:
        values = []
    whole = len(values) == _COLUMNS and all(map(math.isfinite, values)) and all(x.is_integer() for x in values[2:])
    if not whole or not 1 <= values[2] <= count or values[4] not in _CONFIDENCE:
        fix = f"Give `u, v, keypoint, car, visibility` as CarFusion does: keypoint 1 to {count}, visibility 1, 2 or 3."
        raise InvalidInputError(where, line, fix)
    return values


_READERS: Mapping[str, Callable[[Path, Category], Iterator[tuple[Record | InvalidInputError, str]]]] = {
    ".mat": _anchors,  # PASCAL3D+
    ".txt": lambda path, kind: yolo_pose_records(path, kind) if is_yolo_pose(path) else carfusion_records(path),
    ".xml": lambda path, _: cvat_records(path),
}

NOT_JSON = tuple(_READERS)
"""Endings of files of other formats than JSON."""


_BOX, _BEHIND = 5, 2  # numbers before the points, and at most behind them


def is_yolo_pose(path: Path) -> bool:
    """Whether lines are YOLO's and not CarFusion's, which have commas."""
    text = read_text(path, "file")
    return bool(text.strip()) and "," not in text


def yolo_pose_records(path: Path, category: Category) -> Iterator[tuple[Record | InvalidInputError, str]]:
    """The vehicles in the layout of a keypoint file, their points in the order of the lines.

    Args:
        category: The category whose keypoints are wanted: where its size fits, points have as many numbers as that
            tells; else three.
    """
    lines = read_text(path, "file").splitlines()
    image = _yolo_image(path)
    height, width = read_image(image).shape[:2]
    for number, line in enumerate(lines, start=1):
        if not line.strip():
            continue
        where = f"{path}:{number}: "
        try:
            yield {"id": number} | _yolo_record(line, where, (width, height), category) | {"image": image.name}, where
        except InvalidInputError as error:
            yield error, where


def _yolo_image(path: Path) -> Path:
    folders = [path.parent]
    if "labels" in path.parts[:-1]:
        place = len(path.parts) - 2 - path.parts[-2::-1].index("labels")
        folders.append(Path(*path.parts[:place], "images", *path.parts[place + 1 : -1]))
    there = (folder / f"{path.stem}{ending}" for folder in folders for ending in IMAGES)
    found = next((file for file in there if file.is_file()), None)
    if found is None:
        fix = f"Put {path.stem}.jpg beside it, or into images beside labels: the points are shares of its size."
        raise InvalidInputError("keypoints", f"{path}, without its image", fix)
    return found


def _yolo_record(line: str, where: str, size: tuple[int, int], category: Category) -> Record:
    fix = f"Give `class x y width height` and {category.size} points of 2 or 3 numbers, shares of the image."
    try:
        values = [float(word) for word in line.split()]
    except ValueError:
        values = []
    rest = len(values) - _BOX
    if rest < 2 or not all(map(math.isfinite, values)):
        raise InvalidInputError(where.removesuffix(": "), line[:80], fix)
    each = 2 if 0 <= rest - 2 * category.size <= _BEHIND else 3
    count = category.size if 0 <= rest - each * category.size <= _BEHIND else rest // each
    points = [values[_BOX + each * i : _BOX + each * (i + 1)] for i in range(count)]
    behind = values[_BOX + each * count :]
    trusts = [point[2] for point in points] if each == 3 else []
    flags = all(trust in (0.0, 1.0, 2.0) for trust in trusts)
    u, v, width, height = (value * side for value, side in zip(values[1:_BOX], [*size, *size], strict=True))
    record: Record = {
        "keypoints": [_yolo_point(point, size, flags=flags) for point in points],
        "box": [u - width / 2, v - height / 2, u + width / 2, v + height / 2],
    }
    if not flags:
        record["confidence_midpoint"] = PROBABLE
    if len(behind) > 1 or (behind and behind[0] % 1):
        record["score"] = behind.pop(0)
    if behind:
        record["track"] = int(behind[0])
    return record


def _yolo_point(point: list[float], size: tuple[int, int], *, flags: bool) -> list[float] | None:
    """A point in pixels; None where it is none."""
    trust = point[2] if len(point) > 2 else 2.0
    if trust <= 0.0 or point[:2] == [0.0, 0.0]:
        return None
    if flags:
        trust = Observation.confidence_midpoint if trust == 1.0 else 1.0
    return [point[0] * size[0], point[1] * size[1], min(trust, 1.0)]
