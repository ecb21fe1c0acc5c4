"""A 3D box as other detectors give it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.camera import MIN_DEPTH
from fgrecon.core.checks import as_finite
from fgrecon.core.errors import InvalidInputError

__all__ = ["Box3D"]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Box3D:
    """A 3D box as detectors give it, to start from.

    Attributes:
        location: (3,) centre of the box's bottom face in the camera frame, metres.
        rotation_y: Yaw about the camera's y axis, radians.
        size: (3,) length, width and height in metres, or None where the prior's size is to be kept.
    """

    location: Array
    rotation_y: float
    size: Array | None = None

    def __post_init__(self) -> None:
        """Check the numbers.

        Raises:
            InvalidInputError: A number is not finite, the box is behind the camera or has no size.
        """
        location = as_finite("box3d.location", self.location, (3,))
        if location[2] <= MIN_DEPTH:
            raise InvalidInputError("box3d.location", location.tolist(), "Give a box in front of the camera (z > 0).")
        object.__setattr__(self, "location", location)
        if not np.isfinite(self.rotation_y):
            raise InvalidInputError("box3d.rotation_y", self.rotation_y, "Give an angle in radians.")
        if self.size is not None:
            size = as_finite("box3d.size", self.size, (3,))
            if (size <= 0).any():
                raise InvalidInputError("box3d.size", size.tolist(), "Give length, width and height above zero.")
            object.__setattr__(self, "size", size)
