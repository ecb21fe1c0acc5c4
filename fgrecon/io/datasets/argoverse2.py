"""Argoverse 2's sensor data set: logs of feather files.

A cuboid stands in the vehicle's frame at the time of a LiDAR's sweep: its centre, length, width, height, and a
quaternion w, x, y, z from axes forward, left, up. The image that a camera took nearest to a sweep shows its boxes.
`k1`, `k2` and `k3` of the intrinsics are no lens of the images: the devkit projects without them.
"""

from __future__ import annotations

from bisect import bisect_left
from collections import defaultdict
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from fgrecon.core.arrays import Array
from fgrecon.core.camera import Camera
from fgrecon.core.errors import InvalidInputError
from fgrecon.io.datasets.columns import Columns, read_columns
from fgrecon.io.datasets.description import CameraImage, DataSequence, Moment, Reader, Sweep, WorldBox
from fgrecon.io.json_fields import within

_POSES, _CALIBRATION = "city_SE3_egovehicle.feather", "calibration"
_SECONDS = 1e-9  # of a timestamp
QUATERNION, PLACE, SIZE = ("qw", "qx", "qy", "qz"), ("tx_m", "ty_m", "tz_m"), ("length_m", "width_m", "height_m")
_NEAREST_NS = {"ring": 25_000_000, "stereo": 100_000_000}  # the devkit's: half of the interval of such cameras
_CARS = {"REGULAR_VEHICLE": "Car"}


def _read(name: str, log: Path) -> DataSequence:
    """A log."""
    poses = _poses(read_columns(log / _POSES), "timestamp_ns")
    mounts = _poses(read_columns(log / _CALIBRATION / "egovehicle_SE3_sensor.feather"), "sensor_name")
    boxes = _boxes(log / "annotations.feather", poses) if (log / "annotations.feather").is_file() else {}
    scans = {int(file.stem): file for file in sorted((log / "sensors" / "lidar").glob("*.feather"))}
    moments = {
        str(time): Moment(
            name=str(time),
            time=time * _SECONDS,
            world_T_vehicle=_pose_at(poses, time, log),
            boxes=tuple(boxes.get(time, ())),
            labelled=time in boxes,
        )
        for time in sorted({*boxes, *scans})
    }
    images = []
    for camera, lens in _lenses(read_columns(log / _CALIBRATION / "intrinsics.feather")).items():
        files = {int(p.stem): p for p in sorted((log / "sensors" / "cameras" / camera).glob("*.jpg"))}
        farthest = _NEAREST_NS.get(camera.split("_")[0], 0)
        shows = _nearest(sorted(files), sorted({*boxes, *scans}), farthest)
        images += [
            CameraImage(
                camera=camera,
                path=file,
                name=str(time),
                time=time * _SECONDS,
                lens=lens,
                vehicle_T_camera=mounts[camera],
                world_T_vehicle=_pose_at(poses, time, log),
                moment=None if time not in shows else str(shows[time]),
                sweep=Sweep(scans[at], _pose_at(poses, at, log)) if (at := shows.get(time)) in scans else None,
            )
            for time, file in files.items()
        ]
    return DataSequence(name, tuple(images), moments, _CARS)


def _logs(path: Path) -> dict[str, Path]:
    """A log, those of a folder, or those of the splits below it."""
    if (path / _POSES).is_file():
        return {path.name: path}
    found = sorted(path.glob(f"*/{_POSES}")) or sorted(path.glob(f"*/*/{_POSES}"))
    return {file.parent.name: file.parent for file in found}


def _poses(table: Columns, key: str) -> Mapping[Any, Array]:
    """(4, 4) poses by what a column names."""
    return dict(zip(table.values(key), table.poses(QUATERNION, PLACE), strict=True))


def _pose_at(poses: Mapping[Any, Array], time: int, log: Path) -> Array:
    if time not in poses:
        fix = "Give the pose of each image and sweep, as Argoverse 2 has it."
        raise InvalidInputError(f"{log / _POSES}: timestamp_ns", f"none of {time}", fix)
    return poses[time]


def _lenses(table: Columns) -> dict[str, Camera]:
    fx, fy, cx, cy = table.numbers("fx_px", "fy_px", "cx_px", "cy_px").T
    width, height = table.numbers("width_px", "height_px").T.astype(int)
    found = {}
    for i, name in enumerate(table.values("sensor_name")):
        with within(f"{table.where}row {i}: "):
            matrix = np.array([[fx[i], 0.0, cx[i]], [0.0, fy[i], cy[i]], [0.0, 0.0, 1.0]])
            found[str(name)] = Camera(matrix, image_size=(int(width[i]), int(height[i])))
    return found


def _boxes(path: Path, poses: Mapping[Any, Array]) -> dict[int, list[WorldBox]]:
    """The boxes of each labelled sweep by its time."""
    table = read_columns(path)
    found: dict[int, list[WorldBox]] = defaultdict(list)
    places, sizes = table.poses(QUATERNION, PLACE), table.numbers(*SIZE)
    columns = (table.values(name) for name in ("timestamp_ns", "track_uuid", "category"))
    for i, (time, track, kind) in enumerate(zip(*columns, strict=True)):
        city_T_vehicle = _pose_at(poses, int(time), path.parent)
        name = f"{time}-{track}"
        found[int(time)].append(WorldBox(name, str(kind), city_T_vehicle @ places[i], sizes[i], str(track)))
    return found


def _nearest(images: list[int], sweeps: list[int], farthest: int) -> dict[int, int]:
    """The sweep that an image shows: the image is the nearest one to it, and not farther than so much (ns)."""
    shows = {}
    for sweep in sweeps:
        place = bisect_left(images, sweep)
        near = images[max(place - 1, 0) : place + 1]
        best = min(near, key=lambda time: abs(time - sweep), default=None)
        if best is not None and abs(best - sweep) <= farthest:
            shows[best] = sweep
    return shows


READER = Reader("log", _logs, _read)
"""Argoverse 2: a log, a folder of logs, or of its splits."""
