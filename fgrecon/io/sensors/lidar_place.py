"""Where a LiDAR is, from whatever is given: a motion, a calibration of KITTI, nuScenes' tables, or files beside."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fgrecon.io.cameras.camera_source import CameraSource
from fgrecon.io.kitti_calibration import KittiCalibration, calibration_beside, read_calibration
from fgrecon.io.nuscenes import camera_T_lidar, is_nuscenes, open_nuscenes
from fgrecon.io.poses import read_pose

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
