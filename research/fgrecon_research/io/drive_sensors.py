"""Other sensors' files beside the images of a drive.

| file, of frame 12 | content |
|---|---|
| what the data set names | nuScenes' sweep of the sample |
| `lidar/000012.npz` | `points_cm` in the rectified reference camera's frame |
| `velodyne/000012.bin`, `velodyne_points/data/...` | KITTI's scan, in its LiDAR's frame |
| `image_03/000012.png` (or `.jpg`) | the right image of a rectified pair; its camera is P3 |
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace
from enum import StrEnum
from pathlib import Path

import numpy as np

from fgrecon.core.arrays import Array
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.evidence import Points, StereoPair
from fgrecon.core.geometry import rigid
from fgrecon.io.images import read_image
from fgrecon.io.kitti_calibration import calibration_beside
from fgrecon.io.kitti_files import Drive, DriveFrame
from fgrecon.io.sensors.points import read_points


class Sensor(StrEnum):
    """What a drive may have beside its images."""

    LIDAR = "lidar"
    RIGHT = "right"
    DEPTH = "depth"


_PLACES = {
    Sensor.LIDAR: ("lidar/{}.npz", "velodyne/{}.bin", "velodyne_points/data/{}.bin"),
    Sensor.RIGHT: ("image_03/{}.png", "image_03/{}.jpg"),
    Sensor.DEPTH: ("lidar/{}.npz", "velodyne/{}.bin", "velodyne_points/data/{}.bin"),  # of which maps are made
}


def file_of(frame: DriveFrame, sensor: Sensor) -> Path | None:
    """The sensor's file of a frame, or None."""
    if sensor is not Sensor.RIGHT and frame.sweep is not None:
        return frame.sweep if frame.sweep.is_file() else None
    root = frame.image.parent.parent
    files = (root / place.format(frame.image.stem) for place in _PLACES[sensor])
    return next((file for file in files if file.is_file()), None)


def with_sensors(drive: Drive, sensors: Collection[Sensor]) -> Drive:
    """The drive's frames that have files of all the sensors.

    Raises:
        InvalidInputError: No frame has.
    """
    frames = tuple(frame for frame in drive.frames if all(file_of(frame, sensor) for sensor in sensors))
    if not frames:
        names = ", ".join(place.format("FFFFFF") for sensor in sensors for place in _PLACES[sensor])
        raise InvalidInputError("drive", f"no sensor's files in {drive.name}", f"Give a drive with {names}.")
    return replace(drive, frames=frames)


def right_image(frame: DriveFrame) -> StereoPair:
    """The right image of a frame.

    Raises:
        InvalidInputError: There is none, or it cannot be used.
    """
    file = file_of(frame, Sensor.RIGHT)
    right = None if file is None else calibration_beside(file)
    if file is None or right is None:
        raise InvalidInputError("right", f"none of {frame.image}", "Give a frame with image_03 and P3.")
    motion = rigid(np.eye(3), right.label_offset - frame.calibration.label_offset)
    return StereoPair(read_image(file), right.camera, motion)


def scan_of(frame: DriveFrame) -> Points | None:
    """The LiDAR's points of a frame as evidence; None where it has none.

    Raises:
        InvalidInputError: The file cannot be used.
    """
    return None if file_of(frame, Sensor.LIDAR) is None else Points(lidar_points(frame))


def lidar_points(frame: DriveFrame) -> Array:
    """(N, 3) the LiDAR's points of a frame in the camera's frame, metres.

    Raises:
        InvalidInputError: There is no file, or it cannot be used.
    """
    file = file_of(frame, Sensor.LIDAR)
    if file is None:
        raise InvalidInputError("lidar", f"none of {frame.image}", "Give a frame with LiDAR.")
    return read_points(file, frame.calibration)
