"""Vehicles of a keypoint file as plain records, one by one: what can be handed to a worker and read there.

A record is an instance in the layout of `fgrecon.io.keypoint_file` with the camera that the file has for all, its
points in the names or the order of whoever wrote it; `parse_any_keypoints` makes an `Instance` of it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from fgrecon.core.category import Category
from fgrecon.core.errors import InvalidInputError
from fgrecon.io.json_fields import read_json
from fgrecon.io.keypoints.carfusion import carfusion_records
from fgrecon.io.keypoints.coco import annotation_records, is_annotations
from fgrecon.io.keypoints.names import naming_of
from fgrecon.io.keypoints.pascal3d import read_anchors
from fgrecon.io.other_inputs import refuse_results

__all__ = ["NOT_JSON", "keypoint_records", "named_records"]

NOT_JSON = ".mat", ".txt"
"""Endings of files of other formats than JSON: PASCAL3D+, CarFusion."""

_CAMERA = ("K", "intrinsics", "distortion", "image_size")

Record = dict[str, Any]


def keypoint_records(path: Path, category: Category) -> list[Any]:
    """The vehicles of a file of any format, or of a track.

    Args:
        path: The file.
        category: The category whose keypoints are wanted.

    Raises:
        InvalidInputError: The file cannot be read, or its frame is malformed; what a record holds is not looked at.
    """
    if path.suffix.lower() in NOT_JSON:
        return [record for record, _ in named_records(path, category)]
    data = read_json(path)
    if isinstance(data, Mapping) and "frames" in data and "keypoints" not in data:
        return _frames(data, path)
    if is_annotations(data):
        return [record for record, _ in annotation_records(data, f"{path}: ")]
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


def named_records(path: Path, category: Category) -> Iterator[tuple[Record, str]]:
    """The vehicles of a file that is no JSON, their points by name, and what errors about each begin with.

    Raises:
        InvalidInputError: The file cannot be read or is malformed; names it.
    """
    return _anchors(path, category) if path.suffix.lower() == ".mat" else carfusion_records(path)


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
            str(path), f"malformed: {error!r}", "Give a track as docs/formats.md has it."
        ) from error
