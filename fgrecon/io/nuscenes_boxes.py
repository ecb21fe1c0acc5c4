"""2D boxes of nuScenes' objects in an image: its labels are cuboids in the world, which are projected."""

from __future__ import annotations

from itertools import product

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.geometry import transform
from fgrecon.io.json_fields import Fields
from fgrecon.io.nuscenes import NuScenesTables, pose_of

__all__ = ["cuboid_boxes"]

Array = NDArray[np.float64]

_NEAREST = 0.5  # metres; an object that reaches nearer to the camera, or behind it, has no box
_CORNERS = np.array([*product((0.5, -0.5), repeat=3)])


def cuboid_boxes(tables: NuScenesTables, image: str, kind: str) -> list[tuple[str, Array]]:
    """The boxes (4,) of the objects of a category that are in an image, cut at its edges, with their tokens.

    Args:
        tables: The tables; of `sample_annotation`, `instance` and `category` as well.
        image: Name of the image.
        kind: Category, such as `vehicle.car`.

    Raises:
        InvalidInputError: There is no such image, or a record is malformed.
    """
    record = tables.image(image)
    sensor = tables.named(record, "calibrated_sensor_token", "calibrated_sensor")
    matrix = sensor.numbers("camera_intrinsic", (3, 3))
    camera_T_world = np.linalg.inv(pose_of(tables.named(record, "ego_pose_token", "ego_pose")) @ pose_of(sensor))
    limits = np.array([record.get("width", int), record.get("height", int)]) - 1.0
    sample, found = record.get("sample_token", str), []
    for token, label in tables.table("sample_annotation").items():
        if label.data.get("sample_token") == sample and _category(tables, label) == kind:
            width, length, height = label.numbers("size", (3,))
            camera_T_object = camera_T_world @ pose_of(label)
            corners = transform(camera_T_object, _CORNERS * [length, width, height])
            if corners[:, 2].min() < _NEAREST:
                continue
            pixels = corners @ matrix.T
            pixels = pixels[:, :2] / pixels[:, 2:]
            box = np.concatenate([np.clip(pixels.min(0), 0.0, limits), np.clip(pixels.max(0), 0.0, limits)])
            if (box[2:] - box[:2]).min() >= 1.0:
                found.append((token, box))
    return found


def _category(tables: NuScenesTables, label: Fields) -> str:
    instance = tables.named(label, "instance_token", "instance")
    return str(tables.named(instance, "category_token", "category").get("name", str))
