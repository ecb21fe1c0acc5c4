"""Points of one scan from files: in the files' own frame, and in that of a camera by where the LiDAR is.

| ending | content |
|---|---|
| `.bin` | KITTI: four float32 a point, x, y, z and reflectance |
| `.pcd.bin` | nuScenes: five float32 a point, x, y, z, intensity and ring |
| `.npz` | `points` (N, 3) in metres, or `points_cm` (N, 3) in centimetres |
| `.npy` | (N, 3) or wider, of which the first three columns count; or ZOD's records with x, y and z |
| `.feather` | Argoverse 2's sweep: columns x, y, z |
| `.pcd` | of the Point Cloud Library |
| `.ply` | vertices of any mesh or cloud |
| `.las`, `.laz` | of surveys |

Points that are not finite are left out: organised clouds have them where nothing came back.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from functools import partial
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fgrecon.core.arrays import Array
from fgrecon.core.checks import as_path, as_rigid, as_shape
from fgrecon.core.errors import FgreconError, InvalidInputError, MissingPackageError
from fgrecon.core.geometry import rigid, transform
from fgrecon.io.arrays import read_arrays, read_limited, read_lone_array
from fgrecon.io.cameras.camera_source import CameraSource
from fgrecon.io.datasets.columns import Columns
from fgrecon.io.kitti_calibration import KittiCalibration, calibration_beside, read_calibration
from fgrecon.io.nuscenes import camera_T_lidar, is_nuscenes, open_nuscenes
from fgrecon.io.poses import read_pose

Place = NDArray[np.float64] | KittiCalibration
"""A motion (4, 4) from the LiDAR's frame to the camera's, or a calibration that has it."""


def lidar_place(cloud: Path, image: Path, camera: CameraSource, pose: Path | None = None) -> Place | None:
    """Where the LiDAR of a scan is; None where nothing says.

    Args:
        pose: A file with the motion from the LiDAR's frame to the camera's, as `read_pose` takes it; or None.
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
        known = {PointFrame.LIDAR: given.camera_T_lidar, PointFrame.RECTIFIED: rigid(np.eye(3), given.label_offset)}
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


METRES, CENTIMETRES = "points", "points_cm"
"""Names of the arrays in an npz file."""

SENSORS = "fgrecon[sensors]"
"""What has to be installed for some of the formats."""


class PointFrame(StrEnum):
    """Which frame the points of a file have, as far as its format tells."""

    LIDAR = "a LiDAR"
    RECTIFIED = "KITTI's rectified reference camera"
    UNKNOWN = "its own"


class NoPointError(InvalidInputError):
    """A file is whole, but has no finite point."""


@dataclass(frozen=True, eq=False)
class Cloud:
    """The points of a file."""

    points: Array  # (N, 3) metres, all finite, at least one
    frame: PointFrame


def read_cloud(path: Path) -> Cloud:
    """The finite points of a file.

    Raises:
        NoPointError: It has no point.
        InvalidInputError: It cannot be read, or its ending means nothing.
        MissingPackageError: The package that reads such files is not installed.
    """
    ending = ending_of(path)
    read = _READERS.get(ending)
    if read is None:
        raise InvalidInputError("lidar", str(path), f"Give a file that ends in {', '.join(_READERS)}.")
    content = read_limited(path, "lidar")
    try:
        frame, numbers = read(content, path)
        points = as_shape(str(path), numbers, (None, 3), "Give points (N, 3).")
    except FgreconError:
        raise
    except Exception as error:  # the packages promise no kind of error for damaged content
        reason = str(error).partition("\n")[0]
        raise InvalidInputError("lidar", str(path), f"Give a whole file of its kind. The reason: {reason}") from error
    kept = points[np.isfinite(points).all(axis=1)]
    if not len(kept):
        raise NoPointError("lidar", str(path), "Give a file with at least one finite point.")
    return Cloud(kept, frame)


def ending_of(path: Path) -> str:
    """The ending that chooses the format, in small letters: `.pcd.bin` is one."""
    name = path.name.lower()
    return ".pcd.bin" if name.endswith(".pcd.bin") else path.suffix.lower()


_Read = tuple[PointFrame, Any]


def _floats(columns: int, content: bytes, path: Path) -> _Read:
    if len(content) % (4 * columns):
        fix = f"Give {columns} numbers of 4 bytes for each point."
        raise InvalidInputError("lidar", f"{path}: {len(content)} bytes", fix)
    return PointFrame.LIDAR, np.frombuffer(content, dtype="<f4").reshape(-1, columns)[:, :3]


def _npz(content: bytes, path: Path) -> _Read:
    fix = f"Give an array `{METRES}` (N, 3) in metres, or `{CENTIMETRES}` of a KITTI drive."
    arrays = read_arrays(content, str(path), fix, (METRES, CENTIMETRES))
    if len(arrays) != 1:
        raise InvalidInputError("lidar", f"{path}: {', '.join(arrays) or 'neither array'}", fix)
    if METRES in arrays:
        return PointFrame.UNKNOWN, arrays[METRES]
    return PointFrame.RECTIFIED, as_shape(f"{path}: {CENTIMETRES}", arrays[CENTIMETRES], (None, 3), fix) / 100.0


def _npy(content: bytes, path: Path) -> _Read:
    numbers = read_lone_array(content, str(path), "Give an array (N, 3) of numbers.")
    if {"x", "y", "z"} <= set(numbers.dtype.names or ()):
        return PointFrame.LIDAR, np.stack([numbers[axis] for axis in "xyz"], axis=1)
    if numbers.ndim != 2 or numbers.shape[1] < 3:
        raise InvalidInputError("lidar", f"{path}: shape {numbers.shape}", "Give an array (N, 3) of numbers.")
    return PointFrame.UNKNOWN, numbers[:, :3]


def _feather(content: bytes, path: Path) -> _Read:
    from pyarrow import feather

    table = Columns(feather.read_table(BytesIO(content), columns=[*"xyz"]), f"{path}: ")
    return PointFrame.LIDAR, table.numbers(*"xyz")


def _pcd(content: bytes, path: Path) -> _Read:
    try:
        from pypcd4 import PointCloud
    except ImportError as error:
        raise MissingPackageError(SENSORS, f"Reading {path.name}") from error
    return PointFrame.UNKNOWN, PointCloud.from_fileobj(BytesIO(content)).numpy(("x", "y", "z"))


def _ply(content: bytes, path: Path) -> _Read:  # noqa: ARG001 - as all readers
    import trimesh

    loaded = trimesh.load(BytesIO(content), file_type="ply", process=False)
    return PointFrame.UNKNOWN, getattr(loaded, "vertices", np.zeros((0, 3)))  # an empty file is a scene without any


def _las(content: bytes, path: Path) -> _Read:
    try:
        import laspy
    except ImportError as error:
        raise MissingPackageError(SENSORS, f"Reading {path.name}") from error
    return PointFrame.UNKNOWN, laspy.read(BytesIO(content)).xyz


_READERS: dict[str, Callable[[bytes, Path], _Read]] = {
    ".bin": partial(_floats, 4),
    ".pcd.bin": partial(_floats, 5),
    ".npz": _npz,
    ".npy": _npy,
    ".feather": _feather,
    ".pcd": _pcd,
    ".ply": _ply,
    ".las": _las,
    ".laz": _las,
}

CLOUDS = tuple(_READERS)
"""Endings of the files that are read."""
