"""A camera as a calibration file tells of it, and how it is mounted where the file says."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.camera import Camera, Ground

__all__ = ["MountedCamera", "ground_below"]


@dataclass(frozen=True, eq=False)
class MountedCamera:
    """A camera, and what its file says beside it.

    Attributes:
        camera: The camera.
        label_offset: (3,) t in metres: KITTI's label frame lies so from the camera's (a labelled point is at X + t);
            None where the file is none of KITTI's.
        ground: The ground in the camera's frame, where the file says how high and in which direction it is mounted.
        world_T_camera: (4, 4) pose of the camera in the world when it took the image, or None.
    """

    camera: Camera
    label_offset: NDArray[np.float64] | None = None
    ground: Ground | None = None
    world_T_camera: NDArray[np.float64] | None = None


def ground_below(vehicle_T_camera: NDArray[np.float64]) -> Ground | None:
    """The plane z = 0 of a vehicle whose z axis points up, in the frame of a camera on it.

    Args:
        vehicle_T_camera: (4, 4) pose of the camera on the vehicle, metres.

    Returns:
        The plane; None where the camera is upside down or not above it.
    """
    normal, height = -vehicle_T_camera[2, :3], float(vehicle_T_camera[2, 3])
    return Ground(normal, height) if normal[1] > 0.0 and height > 0.0 else None
