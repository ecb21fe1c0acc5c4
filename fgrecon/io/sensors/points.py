"""LiDAR extrinsics, and points in the frame of a camera, from files of any format (`fgrecon.io.sensors.clouds`)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fgrecon.core.arrays import Array
from fgrecon.core.checks import as_path, as_rigid
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.geometry import rigid, transform
from fgrecon.io.cameras.camera_source import CameraSource
from fgrecon.io.kitti_calibration import KittiCalibration, calibration_beside, read_calibration
from fgrecon.io.nuscenes import camera_T_lidar, is_nuscenes, open_nuscenes
from fgrecon.io.poses import read_pose
from fgrecon.io.sensors.clouds import PointFrame, read_cloud

Place = NDArray[np.float64] | KittiCalibration
"""A motion (4, 4) from the LiDAR's frame to the camera's, or a calibration that has it."""


def lidar_place(cloud: Path, image: Path, camera: CameraSource, pose: Path | None = None) -> Place | None:
    """Where the LiDAR of a scan is; None where nothing says.

    Args:
        cloud: The scan's file.
        pose: A file with the motion from the LiDAR's frame to the camera's, as `read_pose` takes it; or None.

    Raises:
        InvalidInputError: A file is malformed.
    """
    if pose is not None:
        return read_pose(pose)
    if camera.calib is not None:
        return read_calibration(camera.calib / f"{image.stem}.txt" if camera.calib.is_dir() else camera.calib)
    if camera.file is not None:
        path = Path(camera.file)
        if is_nuscenes(path):
            return camera_T_lidar(open_nuscenes(path), image.name, cloud.name)
        if path.suffix == ".txt":
            return read_calibration(path)
    return calibration_beside(image)


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
        return as_rigid("camera_T_points", given)
    if frame is not PointFrame.UNKNOWN:
        fix = "Give where that is: KITTI's calibration, nuScenes' tables, or camera_T_points (4, 4)."
        raise InvalidInputError("camera_T_points", f"none, for {path.name} in the frame of {frame.value}", fix)
    return None


def _shift(offset: Array) -> Array:
    return rigid(np.eye(3), offset)
