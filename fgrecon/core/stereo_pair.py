"""The second image of a pair of cameras, which tells the depth of the first."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.camera import Camera
from fgrecon.core.checks import as_rigid, own
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.repr import brief_repr

_RIGID = 1e-3  # by so much an element of R R^T may be off: calibrations have few digits


@dataclass(frozen=True, eq=False)
class StereoPair:
    """The right image of a pair, whose left one shows the vehicles.

    Attributes:
        image: (H, W, 3) RGB, or grey; 8 or 16 bits; as large as the left one.
        camera: The right camera, or its matrix (3, 3), or (fx, fy, cx, cy).
        right_T_left: (4, 4) from the left camera's frame to the right one's, metres: (-baseline, 0, 0) of a rectified
            pair.
    """

    image: NDArray[Any]
    camera: Camera
    right_T_left: NDArray[np.float64]

    __repr__ = brief_repr

    def __post_init__(self) -> None:
        """Check the camera and the motion.

        Raises:
            InvalidInputError: The camera is none, the motion is not rigid, or the right camera is not to the right.
        """
        object.__setattr__(self, "image", np.asarray(self.image))
        object.__setattr__(self, "camera", Camera.of(self.camera))
        motion = as_rigid("right_T_left", self.right_T_left, _RIGID)
        if not motion[0, 3] < 0.0 or abs(motion[0, 3]) < np.abs(motion[1:3, 3]).max():
            fix = "Give the motion from the left camera's frame to the right one's: (-baseline, 0, 0) where rectified."
            raise InvalidInputError("right_T_left", motion[:3, 3].tolist(), fix)
        object.__setattr__(self, "right_T_left", own(motion))
