"""KITTI's cameras and calibration files."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.camera import Camera
from fgrecon.core.checks import as_rigid
from fgrecon.core.errors import InvalidInputError
from fgrecon.io.files import named_lines, numbers

_FOCAL_TOLERANCE = 0.01  # pixels
_RECTIFYING = "R0_rect", "R_rect", "R_rect_00"
_ODOMETRY = "Tr"
_LIDAR = "Tr_velo_to_cam", "Tr_velo_cam", _ODOMETRY
_RAW_LIDAR = "calib_velo_to_cam.txt"
_RECTIFIED_SIZES = {721.5377: (1242, 375), 707.0493: (1224, 370), 718.3351: (1238, 374), 718.856: (1241, 376)}


@dataclass(frozen=True)
class KittiCalibration:
    """One camera of KITTI's rig."""

    camera: Camera  # the camera; its image's size follows from the focal length, where that is one of KITTI's
    # (3,) t in metres: KITTI's labels are in the rectified reference camera, and a labelled point in this camera's
    # frame is X + t (about 6 cm for the left colour camera)
    label_offset: NDArray[np.float64]
    # (4, 4) from the frame of the LiDAR to this camera's; None where the file has no such numbers
    camera_T_lidar: NDArray[np.float64] | None = None


def rectified_size(matrix: NDArray[np.float64]) -> tuple[int, int] | None:
    """Width and height of KITTI's rectified images by their focal length, since no file of KITTI's states them.

    Args:
        matrix: Intrinsics (3, 3) or projection (3, 4).

    Returns:
        The size; None where no drive of KITTI has this focal length.
    """
    for focal, size in _RECTIFIED_SIZES.items():
        if abs(matrix[0, 0] - focal) < _FOCAL_TOLERANCE:
            return size
    return None


def read_calibration(path: Path, projection: str = "P2") -> KittiCalibration:
    """Read the camera of one projection from a calibration file of KITTI: object, tracking, odometry or raw data.

    Args:
        path: Text file with a line `P2: ` and twelve numbers, K [I | t] row by row; in the raw data's
            `calib_cam_to_cam.txt` it is `P_rect_02: `, and `S_rect_02: ` the size of the rectified image.
        projection: Name of the line; P2 is the left colour camera.

    Raises:
        InvalidInputError: The file cannot be read, the line is missing or is no projection; names file and line.
    """
    content = named_lines(path, "calib")
    raw = f"P_rect_{projection.removeprefix('P'):0>2}"
    line = projection if projection in content or raw not in content else raw
    place = f"{path}: {line}"
    fix = f"Give a KITTI calibration file with a line '{projection}:' and twelve numbers, K [I | t] row by row."
    if line not in content:
        raise InvalidInputError(place, "no such line", fix)
    matrix = numbers(content[line], 12, place, fix).reshape(3, 4)
    size = None
    name = f"S_rect_{line[-2:]}"
    if line.startswith("P_rect_") and name in content:
        width, height = numbers(content[name], 2, f"{path}: {name}", "Give width and height in pixels.")
        if min(width, height) < 1:
            raise InvalidInputError(f"{path}: {name}", [width, height], "Give width and height in pixels.")
        size = int(width), int(height)
    try:
        camera = Camera(matrix[:, :3], image_size=size or rectified_size(matrix))
    except InvalidInputError as error:
        raise InvalidInputError(place, error.value, error.fix) from error
    offset: NDArray[np.float64] = np.linalg.solve(matrix[:, :3], matrix[:, 3]).astype(np.float64)
    try:
        lidar = _lidar(path, content, offset)
    except InvalidInputError:  # who wants the camera alone need not mend what the file says of the LiDAR
        lidar = None
    return KittiCalibration(camera, offset, lidar)


def _lidar(path: Path, content: Mapping[str, list[str]], offset: NDArray[np.float64]) -> NDArray[np.float64] | None:
    """(4, 4) from the LiDAR's frame to that of a camera at an offset (3,) from the rectified one; None without it."""
    rectified = next((name for name in _RECTIFYING if name in content), None)
    name = next((name for name in _LIDAR if name in content), None)
    rotation = np.eye(3)
    if name != _ODOMETRY and rectified is not None:  # odometry's is of the rectified frame
        fix = "Give a rotation: nine numbers."
        rotation = numbers(content[rectified], 9, f"{path}: {rectified}", fix).reshape(3, 3)
    beside = path.parent / _RAW_LIDAR
    motion = np.eye(4)
    if name is not None:
        fix = "Give twelve numbers, [R | t] row by row."
        motion[:3] = numbers(content[name], 12, f"{path}: {name}", fix).reshape(3, 4)
    elif beside.is_file() and path.name != _RAW_LIDAR:
        parts = named_lines(beside, "calib")
        fix = "Give lines R: and T: of nine and three numbers."
        motion[:3, :3] = numbers(parts.get("R", []), 9, f"{beside}: R", fix).reshape(3, 3)
        motion[:3, 3] = numbers(parts.get("T", []), 3, f"{beside}: T", fix)
    else:
        return None
    motion[:3] = rotation @ motion[:3]
    motion[:3, 3] += offset
    return as_rigid(f"{path}: {name or _RAW_LIDAR}", motion)


def calibration_beside(image: Path) -> KittiCalibration | None:
    """What KITTI's layouts have for an image: of the object set, drives, the tracking set, raw data; None elsewhere.

    Raises:
        InvalidInputError: There is a calibration file, but it is none.
    """
    folder = image.resolve().parent
    for images, name in ((folder, image.stem), (folder.parent, folder.name)):
        side = images.name.removeprefix("image_")
        if not (images.name.startswith("image_") and side.isdecimal()):
            continue
        root = images.parent
        for path in (root / "calib" / f"{name}.txt", root / "calib.txt", root.parent / "calib_cam_to_cam.txt"):
            if path.is_file():
                return _calibration(path, f"P{int(side)}")
    return None


@lru_cache(maxsize=64)
def _calibration(path: Path, projection: str) -> KittiCalibration:
    return read_calibration(path, projection)
