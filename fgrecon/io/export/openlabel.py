"""Results as OpenLABEL (ASAM's JSON for labels): boxes, cuboids and keypoints of vehicles by the number of the frame.

A cuboid is given by its centre, the quaternion x, y, z, w of its axes forward, left, up, and length, width, height; in
the world where the poses of the camera are known, else in the camera's frame. A 2D box is given by its centre.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Mapping, Sequence
from itertools import count
from typing import Any

import numpy as np

from fgrecon.io.export.annotation_files import keypoints_of
from fgrecon.io.export.image_info import (
    ImageInfo,
    box_in,
    by_image,
    image_box,
    info_of,
    quaternion,
    score,
)
from fgrecon.io.export.results import NamedResult

_KEY = re.compile(r"-?[0-9]+|[0-9a-fA-F]{8}(-[0-9a-fA-F]{4}){3}-[0-9a-fA-F]{12}")
WORLD, CAMERA = "world", "camera"


def openlabel_text(results: Sequence[NamedResult], images: Mapping[str, ImageInfo]) -> str:
    """The JSON of OpenLABEL 1.0.0.

    Args:
        results: Vehicles; those without a pose are left out. One of the same name in several images is one object.
        images: What is known of their images: all that are named are frames, in their order.
    """
    of_images = by_image(results)
    names = list(dict.fromkeys([*(name for name in images if name != "*"), *of_images]))
    posed = all(info_of(name, images).world_T_camera is not None for name in of_images)
    keys = _keys(dict.fromkeys(item.name for items in of_images.values() for item in items))
    objects: dict[str, Any] = {}
    frames: dict[str, Any] = {}
    for number, name in enumerate(names):
        info = info_of(name, images)
        properties: dict[str, Any] = {"streams": {CAMERA: {"uri": name}}}
        if info.timestamp is not None:
            properties["timestamp"] = repr(info.timestamp)
        frame: dict[str, Any] = {"frame_properties": properties, "objects": {}}
        if posed and info.world_T_camera is not None:
            pose = {"matrix4x4": info.world_T_camera.ravel().tolist()}
            properties["transforms"] = {
                f"{CAMERA}_to_{WORLD}": {"src": CAMERA, "dst": WORLD, "transform_src_to_dst": pose}
            }
        for item in of_images.get(name, ()):
            what = objects.setdefault(keys[item.name], {"name": item.name, "type": item.kind or "Car", "frames": []})
            what["frames"].append(number)
            frame["objects"][keys[item.name]] = {"object_data": _data(item, info if posed else ImageInfo())}
        frames[str(number)] = frame
    for what in objects.values():
        what["frame_intervals"] = _intervals(what.pop("frames"))
    systems = {CAMERA: {"type": "sensor_cs", "parent": WORLD if posed else "", "children": []}}
    if posed:
        systems[WORLD] = {"type": "scene_cs", "parent": "", "children": [CAMERA]}
    content = {
        "metadata": {"schema_version": "1.0.0", "annotator": "fgrecon"},
        "coordinate_systems": systems,
        "streams": {CAMERA: {"type": "camera", "uri": "", "description": ""}},
        "objects": objects,
        "frames": frames,
        "frame_intervals": _intervals(list(range(len(names)))),
    }
    return json.dumps({"openlabel": content}, allow_nan=False) + "\n"


def _keys(names: Iterable[str]) -> dict[str, str]:
    """The keys of objects by their names: OpenLABEL wants whole numbers or UUIDs, so that other names get numbers."""
    named = list(names)
    taken = {name for name in named if _KEY.fullmatch(name)}
    free = (number for number in map(str, count()) if number not in taken)
    return {name: name if name in taken else next(free) for name in named}


def _data(item: NamedResult, info: ImageInfo) -> dict[str, Any]:
    """What an image shows of a vehicle."""
    result = item.result
    centre, axes = box_in(info, result.camera_T_object, result.box_size)
    low, high = np.split(image_box(item), 2)
    system = WORLD if info.world_T_camera is not None else CAMERA
    cuboid = [*centre.tolist(), *quaternion(axes), *result.box_size.tolist()]
    points = [
        {
            "name": name,
            "val": uv.tolist(),
            "coordinate_system": CAMERA,
            "attributes": {"boolean": [{"name": "visible", "val": seen}]},
        }
        for name, uv, seen in keypoints_of(item)
    ]
    told = {"confidence": float(score(item))} | ({} if item.track is None else {"track": item.track})
    box = [*((low + high) / 2.0).tolist(), *(high - low).tolist()]
    return {
        "cuboid": [{"name": "shape3D", "val": cuboid, "coordinate_system": system}],
        "bbox": [{"name": "shape", "val": box, "coordinate_system": CAMERA}],
        "point2d": points,
        "num": [{"name": name, "val": value} for name, value in told.items()],
    }


def _intervals(numbers: Sequence[int]) -> list[dict[str, int]]:
    """Numbers, growing, as intervals."""
    found: list[dict[str, int]] = []
    for number in numbers:
        if found and found[-1]["frame_end"] == number - 1:
            found[-1]["frame_end"] = number
        else:
            found.append({"frame_start": number, "frame_end": number})
    return found
