"""What is known to be true about a vehicle, for drawing beside an estimate."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.checks import as_finite, as_rigid, as_shape, own
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.metrics import orientation_error, translation_error
from fgrecon.core.reconstruction import rotation_y

ORIENTATION_ERROR = "orientation_deg"
TRANSLATION_ERROR = "translation_m"
SHAPE_ERROR = "keypoints_m"

_RIGID = 1e-5  # by so much a rotation may fail to be one: single precision does


@dataclass(frozen=True)
class Truth:
    """The true pose, and box and keypoints where they are known.

    Attributes:
        camera_T_object: (4, 4) true pose, maps object coordinates into the camera frame.
        box_size: (3,) true length, width and height in metres, or None.
        keypoints: (K, 3) true keypoints in the object frame, metres, or None; NaN rows are not known.
    """

    camera_T_object: NDArray[np.float64]
    box_size: NDArray[np.float64] | None = None
    keypoints: NDArray[np.float64] | None = None

    def __post_init__(self) -> None:
        """Check the arrays.

        Raises:
            InvalidInputError: A wrong shape, a pose that is no rigid motion, or a size that is not positive.
        """
        pose = as_rigid("truth.camera_T_object", self.camera_T_object, _RIGID)
        object.__setattr__(self, "camera_T_object", own(pose))
        if self.box_size is not None:
            size = as_finite("truth.box_size", self.box_size, (3,), "Give length, width and height in metres.")
            if (size <= 0).any():
                raise InvalidInputError("truth.box_size", size.tolist(), "Give positive lengths in metres.")
            object.__setattr__(self, "box_size", own(size))
        if self.keypoints is not None:
            object.__setattr__(self, "keypoints", own(as_shape("truth.keypoints", self.keypoints, (None, 3))))

    def errors(self, camera_T_object: NDArray[np.float64], keypoints: NDArray[np.float64]) -> Mapping[str, float]:
        """How far an estimate is from the truth.

        Args:
            camera_T_object: (4, 4) estimated pose.
            keypoints: (K, 3) estimated keypoints in the object frame, metres.

        Returns:
            `orientation_deg`: |wrapped difference of rotation_y|, degrees; `translation_m`: distance of the origins,
            metres; and where true keypoints are known `keypoints_m`: mean distance in the object frame, metres.
        """
        yaws = [rotation_y(camera_T_object)], [rotation_y(self.camera_T_object)]
        errors = {
            ORIENTATION_ERROR: float(orientation_error(*yaws)[0]),
            TRANSLATION_ERROR: float(
                translation_error(camera_T_object[None, :3, 3], self.camera_T_object[None, :3, 3])[0]
            ),
        }
        if self.keypoints is not None and self.keypoints.shape == keypoints.shape:
            distances = np.linalg.norm(keypoints - self.keypoints, axis=1)
            if np.isfinite(distances).any():
                errors[SHAPE_ERROR] = float(distances[np.isfinite(distances)].mean())
        return errors
