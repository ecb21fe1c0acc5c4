"""A picture of a car with its labels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Pixels = NDArray[np.uint8]


@dataclass(frozen=True)
class LabelledView:
    """A photograph of a car with its labels."""

    image: Pixels  # (H, W, 3) RGB
    mask: Pixels  # (H, W) 255 on the car, 0 elsewhere
    keypoints: Array  # (K, 2) pixels; NaN where unknown
    visible: Array  # (K,) probability that each can be seen
    azimuth: float  # direction from the car to the camera, radians; 0 ahead, pi / 2 to its left
    # (4,) box of the car x1, y1, x2, y2 in pixels, where the image shows more than the car; else None
    within: Array | None = None

    @property
    def box(self) -> Array:
        """(4,) box of the car x1, y1, x2, y2 in pixels."""
        height, width = self.image.shape[:2]
        return np.array([-0.5, -0.5, width - 0.5, height - 0.5]) if self.within is None else self.within

    def mirrored(self, partner: NDArray[np.intp]) -> LabelledView:
        """The mirror image, in which left and right of the car have changed places."""
        flipped = self.keypoints[partner] * [-1.0, 1.0] + [self.image.shape[1] - 1.0, 0.0]
        image, mask = (np.ascontiguousarray(a[:, ::-1]) for a in (self.image, self.mask))
        within = self.within
        if within is not None:
            x1, y1, x2, y2 = within
            within = np.array([self.image.shape[1] - 1.0 - x2, y1, self.image.shape[1] - 1.0 - x1, y2])
        return LabelledView(image, mask, flipped, self.visible[partner], -self.azimuth, within)
