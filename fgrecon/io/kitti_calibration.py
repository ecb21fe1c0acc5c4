"""KITTI's cameras and calibration files."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.camera import Camera
from fgrecon.core.errors import InvalidInputError

__all__ = ["KittiCalibration", "read_calibration", "rectified_size"]

_FOCAL_TOLERANCE = 0.01  # pixels
_RECTIFIED_SIZES = {721.5377: (1242, 375), 707.0493: (1224, 370), 718.3351: (1238, 374), 718.856: (1241, 376)}


@dataclass(frozen=True)
class KittiCalibration:
    """One camera of KITTI's rig.

    Attributes:
        camera: The camera; its image's size follows from the focal length, where that is one of KITTI's.
        label_offset: (3,) t in metres: KITTI's labels are in the rectified reference camera, and a labelled point in
            this camera's frame is X + t (about 6 cm for the left colour camera).
    """

    camera: Camera
    label_offset: NDArray[np.float64]


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
    """Read the camera of one projection from a calibration file of KITTI's object or tracking set.

    Args:
        path: Text file with a line `P2: ` and twelve numbers, K [I | t] row by row.
        projection: Name of the line; P2 is the left colour camera.

    Raises:
        InvalidInputError: The file cannot be read, the line is missing or is no projection; names file and line.
    """
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except OSError as error:
        raise InvalidInputError("calib", str(path), f"Give a file that can be read ({error.strerror}).") from error
    except UnicodeDecodeError as error:
        raise InvalidInputError("calib", str(path), "Give a text file of KITTI's calibration.") from error
    place = f"{path}: {projection}"
    fix = f"Give a KITTI calibration file with a line '{projection}:' and twelve numbers, K [I | t] row by row."
    found = [line.partition(":")[2].split() for line in lines if line.partition(":")[0].strip() == projection]
    if not found:
        raise InvalidInputError(place, "no such line", fix)
    try:
        numbers = np.array(found[0], dtype=np.float64)
    except ValueError:
        raise InvalidInputError(place, " ".join(found[0]), fix) from None
    if numbers.shape != (12,) or not np.isfinite(numbers).all():
        raise InvalidInputError(place, " ".join(found[0]), fix)
    matrix = numbers.reshape(3, 4)
    try:
        camera = Camera(matrix[:, :3], image_size=rectified_size(matrix))
    except InvalidInputError as error:
        raise InvalidInputError(place, error.value, error.fix) from error
    return KittiCalibration(camera, np.linalg.solve(matrix[:, :3], matrix[:, 3]).astype(np.float64))
