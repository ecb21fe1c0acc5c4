"""A photograph on its way into recordings. Several vehicles may be in one, and it is encoded once for all of them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgrecon.viz.geometry import as_image

__all__ = ["Photograph"]

_JPEG_QUALITY = 92


@dataclass(frozen=True, eq=False)
class Photograph:
    """A photograph that one or several recordings show.

    Attributes:
        pixels: (H, W, 3) RGB bytes.
    """

    pixels: NDArray[np.uint8]

    @classmethod
    def of(cls, image: NDArray[np.uint8] | Photograph | None) -> Photograph | None:
        """An image as a photograph; None where there is none.

        Raises:
            InvalidInputError: The image is not (H, W, 3) of bytes.
        """
        return image if image is None or isinstance(image, Photograph) else cls(as_image(image))

    @cached_property
    def columns(self) -> list[Any]:
        """It as a JPEG in component columns of one row."""
        import cv2
        import rerun as rr

        bgr = np.ascontiguousarray(self.pixels[..., ::-1])
        jpeg = cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])[1]
        return list(rr.EncodedImage.columns(blob=[bytes(jpeg)]))
