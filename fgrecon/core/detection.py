"""Keypoints of one vehicle as a detector found them, with what it says beside them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.brief import brief_repr
from fgrecon.core.checks import as_finite
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.observation import Observation

__all__ = ["Detection"]

_SUM = 1e-3
"""By so much the sum of probabilities may be off."""


@dataclass(frozen=True, eq=False)
class Detection:
    """Keypoints of one vehicle, and from where it is seen.

    Attributes:
        observation: Keypoints, confidences, covariances and box, pixels of the image.
        azimuth: (A,) probability of each direction from the vehicle to the camera: bin a is centred at 2 pi a / A,
            0 ahead of the vehicle, pi / 2 to its left. It decides between poses that explain the keypoints alike. None
            where the detector does not say.
        visible: (K,) probability of each keypoint to be visible, wherever it is; or None.
    """

    observation: Observation
    azimuth: NDArray[np.float64] | None = None
    visible: NDArray[np.float64] | None = None

    __repr__ = brief_repr

    def __post_init__(self) -> None:
        """Check the arrays.

        Raises:
            InvalidInputError: The observation is none, or the directions or visibilities are no probabilities.
        """
        if not isinstance(self.observation, Observation):
            raise InvalidInputError("detection.observation", self.observation, "Give an `fgrecon.Observation`.")
        if self.azimuth is not None:
            azimuth = as_finite("detection.azimuth", self.azimuth, (None,))
            if (azimuth < 0).any() or abs(azimuth.sum() - 1.0) > _SUM:
                fix = "Give a probability for each direction, with the sum 1."
                raise InvalidInputError("detection.azimuth", f"numbers of sum {azimuth.sum():g}", fix)
            object.__setattr__(self, "azimuth", azimuth)
        if self.visible is not None:
            visible = as_finite("detection.visible", self.visible, (len(self.observation.keypoints),))
            if ((visible < 0) | (visible > 1)).any():
                raise InvalidInputError("detection.visible", visible.tolist(), "Give probabilities from 0 to 1.")
            object.__setattr__(self, "visible", visible)
