"""Vehicles of a keypoint file as plain records, one by one: what can be handed to a worker and read there.

A record is an instance in the layout of `fgrecon.io.keypoint_file` with the camera that the file has for all, its
points in the names or the order of whoever wrote it; `parse_any_keypoints` makes an `Instance` of it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

from fgrecon.core.category import Category
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.observation import Observation
from fgrecon.io.json_fields import read_json
from fgrecon.io.keypoint_file import refuse_results
from fgrecon.io.keypoints.coco_records import annotation_records, is_annotations
from fgrecon.io.keypoints.names import naming_of, scheme_keypoints
from fgrecon.io.keypoints.network_results import network_instances
from fgrecon.io.keypoints.pascal3d import read_anchors
from fgrecon.io.keypoints.tool_records import cvat_records, is_tool_file, tool_records
from fgrecon.io.keypoints.yolo_pose import is_yolo_pose, yolo_pose_records
from fgrecon.io.text_lines import filled_lines

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
    """The vehicles of a file that is no JSON, their points by name, and what errors about each begin with.

    Raises:
        InvalidInputError: The file cannot be read or is malformed; names it.
    """
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

    Raises:
        InvalidInputError: The file cannot be read, or a line is malformed; names it.
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
