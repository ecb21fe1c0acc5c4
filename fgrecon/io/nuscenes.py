"""The tables of nuScenes: JSON lists of records with tokens, of which some name records of other tables.

Quaternions are w, x, y, z. The sensor's pose is on the vehicle (x forward, y left, z up, origin on the ground below the
rear axle), the vehicle's in the world; a camera's own frame is that of fgrecon.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache
from itertools import product
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.arrays import Array
from fgrecon.core.checks import as_quaternion
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.geometry import quaternion_pose, transform
from fgrecon.io.json_fields import Fields, read_records

_TABLES = "calibrated_sensor", "sample_data"


@dataclass(frozen=True)
class NuScenesTables:
    """A folder of tables; each is read when it is first asked for."""

    folder: Path  # the folder, such as `v1.0-mini`

    def table(self, name: str) -> Mapping[str, Fields]:
        """The records of a table by their tokens."""
        path = self.folder / f"{name}.json"
        try:
            changed = path.stat().st_mtime_ns
        except OSError:
            raise InvalidInputError(str(path), "no such file", "Give a folder with nuScenes' tables.") from None
        return _table(path, changed)

    def named(self, record: Fields, field: str, table: str) -> Fields:
        """The record of another table that a record names."""
        token = record.get(field, str)
        found = self.table(table).get(token)
        if found is None:
            fix = f"Give the token of a record in {self.folder / table}.json."
            raise InvalidInputError(f"{record.where}{field}", token, fix)
        return found

    def image(self, name: str) -> Fields:
        """The record of an image by the name of its file."""
        stem = Path(name).stem
        for record in self.table("sample_data").values():
            if Path(record.get("filename", str)).stem == stem:
                return record
        raise InvalidInputError("image", name, f"Give an image that {self.folder / 'sample_data.json'} names.")


def is_nuscenes(path: Path) -> bool:
    """Whether a folder, or the folder of a file, has nuScenes' tables, and the file is one of them."""
    if path.is_dir():
        return all((path / f"{name}.json").is_file() for name in _TABLES)
    return path.suffix == ".json" and path.stem in (*_TABLES, "sensor", "ego_pose") and is_nuscenes(path.parent)


def open_nuscenes(path: Path) -> NuScenesTables:
    """The tables of a folder, or of the folder that a table is in."""
    return NuScenesTables(path if path.is_dir() else path.parent)


def pose_of(record: Fields) -> NDArray[np.float64]:
    """(4, 4) pose of a record's `rotation` (w, x, y, z) and `translation`, metres.

    Raises:
        InvalidInputError: One is missing or malformed, or the rotation is none; names the field.
    """
    quaternion = as_quaternion(f"{record.where}rotation", record.numbers("rotation", (4,)))
    return quaternion_pose(quaternion, record.numbers("translation", (3,)))


@lru_cache(maxsize=8)
def _table(path: Path, changed: int) -> Mapping[str, Fields]:  # noqa: ARG001  # a changed file is read again
    return {record.get("token", str): record for record in read_records(path, "a table of nuScenes: a list of records")}


NEAREST = 0.5
"""Metres: an object that reaches nearer to the camera, or behind it, has no box."""

_CORNERS = np.array([*product((0.5, -0.5), repeat=3)])


class CuboidBox(NamedTuple):
    """A labelled object of an image: token, category such as `vehicle.car`, and (4,) box; None where it has none."""

    token: str
    category: str
    corners: Array | None


def cuboid_boxes(tables: NuScenesTables, image: str) -> Iterator[CuboidBox]:
    """The labelled objects that are in an image, with their boxes, cut at its edges.

    Those that reach nearer to the camera than its near plane have none.

    Args:
        tables: The tables; of `sample_annotation`, `instance` and `category` as well.
    """
    record = tables.image(image)
    sensor = tables.named(record, "calibrated_sensor_token", "calibrated_sensor")
    matrix = sensor.numbers("camera_intrinsic", (3, 3))
    camera_T_world = np.linalg.inv(pose_of(tables.named(record, "ego_pose_token", "ego_pose")) @ pose_of(sensor))
    limits = np.array([record.get("width", int), record.get("height", int)]) - 1.0
    sample = record.get("sample_token", str)
    for token, label in tables.table("sample_annotation").items():
        if label.data.get("sample_token") == sample:
            width, length, height = label.numbers("size", (3,))
            camera_T_object = camera_T_world @ pose_of(label)
            corners = transform(camera_T_object, _CORNERS * [length, width, height])
            if corners[:, 2].min() < NEAREST:
                if corners[:, 2].max() > NEAREST:
                    yield CuboidBox(token, _category(tables, label), None)
                continue
            pixels = corners @ matrix.T
            pixels = pixels[:, :2] / pixels[:, 2:]
            box = np.concatenate([np.clip(pixels.min(0), 0.0, limits), np.clip(pixels.max(0), 0.0, limits)])
            if (box[2:] - box[:2]).min() >= 1.0:
                yield CuboidBox(token, _category(tables, label), box)


def camera_T_lidar(tables: NuScenesTables, image: str, sweep: str) -> Array:
    """(4, 4) from a LiDAR's frame at its sweep to a camera's at its image; the vehicle moves between the two.

    Raises:
        InvalidInputError: There is no such image or sweep, or a record is malformed.
    """
    places = []
    for name in (image, sweep):
        record = tables.image(name)
        sensor = tables.named(record, "calibrated_sensor_token", "calibrated_sensor")
        places.append(pose_of(tables.named(record, "ego_pose_token", "ego_pose")) @ pose_of(sensor))
    world_T_camera, world_T_lidar = places
    return np.asarray(np.linalg.solve(world_T_camera, world_T_lidar))


def sweep_of(tables: NuScenesTables, image: str) -> str | None:
    """Name of the file of the LiDAR's sweep that belongs to an image; None where there is none."""
    sample = tables.image(image).get("sample_token", str)
    for record in tables.table("sample_data").values():
        name = record.get("filename", str)
        if name.endswith(".pcd.bin") and record.get("sample_token", str) == sample and record.data.get("is_key_frame"):
            return Path(name).name
    return None


def _category(tables: NuScenesTables, label: Fields) -> str:
    instance = tables.named(label, "instance_token", "instance")
    return str(tables.named(instance, "category_token", "category").get("name", str))
