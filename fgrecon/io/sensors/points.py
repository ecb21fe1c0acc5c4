"""Points of a LiDAR in the frame of a camera, from files of any format (`fgrecon.io.sensors.clouds`)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fgrecon.core.checks import as_path, as_rigid
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.geometry import transform
from fgrecon.io.kitti_calibration import KittiCalibration
from fgrecon.io.sensors.clouds import PointFrame, read_cloud

Array = NDArray[np.float64]

_RIGID = 1e-3  # by so much an element of R R^T may be off: calibrations have few digits


def read_points(path: str | Path, camera_T_points: ArrayLike | KittiCalibration | None = None) -> Array:
    """(N, 3) points of a file in the camera's frame (x right, y down, z forward), metres.

    Args:
        path: The file; see `fgrecon.io.sensors.clouds`.
        camera_T_points: (4, 4) from the file's frame to the camera's; or a KITTI calibration, which says where its
            LiDAR is (`.bin`) and where its rectified frame is (`points_cm`). None: the file has the camera's frame,
            as all other files beside a KITTI calibration.

    Raises:
        InvalidInputError: The file cannot be read, nothing says where its LiDAR is, or the motion is not rigid.
        MissingPackageError: The package that reads such files is not installed.
    """
    file = as_path("lidar", path)
    cloud = read_cloud(file)
    motion = _motion(file, cloud.frame, camera_T_points)
    return cloud.points if motion is None else transform(motion, cloud.points)


def _motion(path: Path, frame: PointFrame, given: ArrayLike | KittiCalibration | None) -> Array | None:
    if isinstance(given, KittiCalibration):
        known = {PointFrame.LIDAR: given.camera_T_lidar, PointFrame.RECTIFIED: _shift(given.label_offset)}
        if frame is PointFrame.LIDAR and given.camera_T_lidar is None:
            fix = "Give one with twelve numbers of Tr_velo_to_cam, Tr_velo_cam (tracking set) or Tr (odometry)."
            raise InvalidInputError("calib", f"no LiDAR, for {path.name}", fix)
        return known.get(frame)
    if given is not None:
        return as_rigid("camera_T_points", given, _RIGID)
    if frame is not PointFrame.UNKNOWN:
        fix = "Give where that is: KITTI's calibration, nuScenes' tables, or camera_T_points (4, 4)."
        raise InvalidInputError("camera_T_points", f"none, for {path.name} in the frame of {frame.value}", fix)
    return None


def _shift(offset: Array) -> Array:
    motion = np.eye(4)
    motion[:3, 3] = offset
    return motion
