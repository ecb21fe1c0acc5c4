"""Waymo Open Dataset, version 2: segments as tables of Parquet, a file for each kind of content.

A box stands in the frame of the vehicle (x forward, y left, z up): its centre, size along x, y, z, and its heading from
x to y. A camera looks along its x axis; its lens has OpenCV's k1, k2, p1, p2, k3, as Waymo's own model without the
rolling shutter. An image has the pose of the vehicle when it was taken, the boxes that of their frame.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from fgrecon.core.arrays import Array
from fgrecon.core.camera import Camera
from fgrecon.core.checks import as_rigid
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.geometry import AHEAD, rigid
from fgrecon.io.datasets.columns import Columns, read_columns
from fgrecon.io.datasets.description import CameraImage, DataSequence, Moment, Reader, WorldBox, unpacked_images
from fgrecon.io.json_fields import within

_IMAGES, _CAMERAS, _BOXES, _POSES = "camera_image", "camera_calibration", "lidar_box", "vehicle_pose"
_TIME, _CAMERA = "key.frame_timestamp_micros", "key.camera_name"
_MICROSECONDS = 1e-6
CAMERAS = {1: "FRONT", 2: "FRONT_LEFT", 3: "FRONT_RIGHT", 4: "SIDE_LEFT", 5: "SIDE_RIGHT"}
_KINDS = {0: "TYPE_UNKNOWN", 1: "TYPE_VEHICLE", 2: "TYPE_PEDESTRIAN", 3: "TYPE_SIGN", 4: "TYPE_CYCLIST"}
_CARS = {"TYPE_VEHICLE": "Car"}


def _segments(path: Path) -> dict[str, Path]:
    """The folder of the tables by the names of the segments: there are images, their cameras and poses."""
    if not all((path / name).is_dir() for name in (_CAMERAS, _POSES)):
        return {}
    return {file.stem: path for file in sorted((path / _IMAGES).glob("*.parquet"))}


def _read(name: str, path: Path) -> DataSequence:
    """A segment; its images stay in their table until they are looked at."""
    poses = _poses(read_columns(path / _POSES / f"{name}.parquet"), "[VehiclePoseComponent].world_from_vehicle")
    at = dict(zip(read_columns(path / _POSES / f"{name}.parquet", [_TIME]).values(_TIME), poses, strict=True))
    labels = path / _BOXES / f"{name}.parquet"
    boxes = _boxes(read_columns(labels), at) if labels.is_file() else {}
    moments = {
        str(time): Moment(str(time), time * _MICROSECONDS, pose, tuple(boxes.get(time, ())), time in boxes)
        for time, pose in at.items()
    }
    lenses, mounts = _cameras(read_columns(path / _CAMERAS / f"{name}.parquet"))
    file = path / _IMAGES / f"{name}.parquet"
    own = "[CameraImageComponent].pose"
    table = read_columns(file, [_TIME, _CAMERA, f"{own}.transform", f"{own}_timestamp"])
    taken = table.values(f"{own}_timestamp")
    images = []
    for row, (time, camera, pose) in enumerate(
        zip(table.values(_TIME), table.values(_CAMERA), _poses(table, own), strict=True)
    ):
        if camera not in lenses:
            raise InvalidInputError(f"{table.where}{_CAMERA}", camera, f"Give its row in {path / _CAMERAS}.")
        images.append(
            CameraImage(
                camera=CAMERAS.get(camera, str(camera)),
                path=unpacked_images() / name / CAMERAS.get(camera, str(camera)) / f"{time}.jpg",
                name=str(time),
                time=float(taken[row]),
                lens=lenses[camera],
                vehicle_T_camera=mounts[camera],
                world_T_vehicle=pose,
                moment=str(time) if time in at else None,
                content=partial(_jpeg, file, row),
            )
        )
    return DataSequence(name, tuple(images), moments, _CARS)


def _jpeg(file: Path, row: int) -> bytes:
    """The image of a row of the table."""
    import pyarrow.parquet as pq

    with pq.ParquetFile(file) as table:
        group = 0
        while row >= (count := table.metadata.row_group(group).num_rows):
            group, row = group + 1, row - count
    return bytes(_images_of(file, group)[row].as_py())


@lru_cache(maxsize=1)
def _images_of(file: Path, group: int) -> Any:
    """The images of a part of the table."""
    import pyarrow.parquet as pq

    return pq.ParquetFile(file).read_row_group(group, columns=["[CameraImageComponent].image"]).column(0)


def _poses(table: Columns, name: str) -> Array:
    """(N, 4, 4) of a column of rows of 16 numbers."""
    column = f"{name}.transform"
    values = table.values(column)
    try:
        found = np.array(values, dtype=np.float64).reshape(-1, 4, 4)
    except (TypeError, ValueError):
        raise InvalidInputError(f"{table.where}{column}", "no matrices", "Give 16 numbers a row.") from None
    return np.array([as_rigid(f"{table.where}{column}", pose) for pose in found]).reshape(-1, 4, 4)


def _cameras(table: Columns) -> tuple[dict[int, Camera], dict[int, Array]]:
    part = "[CameraCalibrationComponent]"
    names = [f"{part}.intrinsic.{n}" for n in ("f_u", "f_v", "c_u", "c_v", "k1", "k2", "p1", "p2", "k3")]
    sizes = table.numbers(f"{part}.width", f"{part}.height").astype(int).tolist()
    lenses, mounts = {}, {}
    for row, (camera, numbers, pose) in enumerate(
        zip(table.values(_CAMERA), table.numbers(*names), _poses(table, f"{part}.extrinsic"), strict=True)
    ):
        fu, fv, cu, cv, *lens = numbers.tolist()
        with within(f"{table.where}row {row}: "):
            matrix = np.array([[fu, 0.0, cu], [0.0, fv, cv], [0.0, 0.0, 1.0]])
            lenses[int(camera)] = Camera(matrix, np.array(lens), (sizes[row][0], sizes[row][1]))
        mounted = pose.copy()
        mounted[:3, :3] = pose[:3, :3] @ AHEAD
        mounts[int(camera)] = mounted
    return lenses, mounts


def _boxes(table: Columns, poses: Mapping[Any, Array]) -> dict[int, list[WorldBox]]:
    """The boxes of each frame by its time."""
    part = "[LiDARBoxComponent]"
    numbers = table.numbers(
        *(f"{part}.box.{kind}.{axis}" for kind in ("center", "size") for axis in "xyz"), f"{part}.box.heading"
    )
    found: dict[int, list[WorldBox]] = defaultdict(list)
    columns = (table.values(name) for name in (_TIME, "key.laser_object_id", f"{part}.type"))
    for (x, y, z, length, width, height, heading), time, track, kind in zip(numbers, *columns, strict=True):
        if time not in poses:
            raise InvalidInputError(f"{table.where}{_TIME}", time, "Give the vehicle's pose of this frame.")
        cosine, sine = np.cos(heading), np.sin(heading)
        vehicle_T_box = rigid([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]], (x, y, z))
        pose, size = poses[time] @ vehicle_T_box, np.array([length, width, height])
        found[time].append(WorldBox(f"{time}-{track}", _KINDS.get(kind, str(kind)), pose, size, track))
    return found


READER = Reader("segment", _segments, _read)
"""Waymo's folder of tables."""
