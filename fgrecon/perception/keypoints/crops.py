"""The square crop around a vehicle that the networks look at, and its geometry. Pixel centres are integers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fgrecon.core.repr import brief_repr

MARGIN = 1.2
"""Side of the crop relative to the longer side of the box."""

FILL = 127
"""Value of pixels beyond the image's border: zero to the network."""


@dataclass(frozen=True)
class Crop:
    """A square of an image, resampled to S x S pixels."""

    centre: NDArray[np.float64]  # (2,) its centre in the image, pixels
    side: float  # its side in the image, pixels
    size: int  # S

    __repr__ = brief_repr

    @property
    def scale(self) -> float:
        """Pixels of the crop per pixel of the image."""
        return self.size / self.side

    def to_image(self, pixels: ArrayLike) -> NDArray[np.float64]:
        """Pixels of the crop (..., 2) as pixels of the image."""
        return (np.asarray(pixels) - (self.size - 1) / 2) / self.scale + self.centre

    def from_image(self, pixels: ArrayLike) -> NDArray[np.float64]:
        """Pixels of the image (..., 2) as pixels of the crop."""
        return (np.asarray(pixels) - self.centre) * self.scale + (self.size - 1) / 2


def crop_of(box: ArrayLike, size: int, margin: float = MARGIN) -> Crop:
    """The crop around a box x1, y1, x2, y2 in pixels."""
    x1, y1, x2, y2 = np.asarray(box, dtype=np.float64)
    return Crop(np.array([(x1 + x2) / 2, (y1 + y2) / 2]), max(x2 - x1, y2 - y1) * margin, size)


def extract(image: NDArray[np.uint8], crop: Crop) -> NDArray[np.uint8]:
    """The pixels (S, S, 3) of a crop of an image (H, W, 3); averaged where the image is finer than the crop."""
    import cv2

    # Only the part of the image under the crop: OpenCV cannot warp images of more than 32767 pixels a side.
    height, width = image.shape[:2]
    reach = crop.side / 2 + 2.0 / min(crop.scale, 1.0)
    low = np.clip(np.floor(crop.centre - reach), 0, [width - 1, height - 1]).astype(int)
    high = np.clip(np.ceil(crop.centre + reach) + 1, low + 1, [width, height]).astype(int)
    part = np.ascontiguousarray(image[low[1] : high[1], low[0] : high[0]])
    centre = crop.centre - low
    while crop.side / crop.size > 2.0 and max(part.shape) > 1024:  # bring enormous parts down to a workable size first
        shrink = max(int(crop.side / crop.size), 2)
        part = part[: max(len(part) // shrink, 1) * shrink, : max(part.shape[1] // shrink, 1) * shrink]
        smaller = (max(part.shape[1] // shrink, 1), max(part.shape[0] // shrink, 1))
        part = np.asarray(cv2.resize(part, smaller, interpolation=cv2.INTER_AREA), dtype=np.uint8)
        centre, crop = (centre + 0.5) / shrink - 0.5, Crop(crop.centre, crop.side / shrink, crop.size)
    finer = 2 ** max(0, int(np.ceil(np.log2(crop.side / crop.size))))
    size = crop.size * finer
    scale = size / crop.side
    shift = (size - 1) / 2 - scale * centre
    matrix = np.array([[scale, 0.0, shift[0]], [0.0, scale, shift[1]]])
    pixels = cv2.warpAffine(
        part, matrix, (size, size), flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=(FILL,) * 3
    )
    if finer > 1:
        pixels = cv2.resize(pixels, (crop.size, crop.size), interpolation=cv2.INTER_AREA)
    return np.asarray(pixels, dtype=np.uint8)
