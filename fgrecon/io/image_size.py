"""The size that a file states of an image, against the size of the picture or of the camera's images.

Pixels of a picture that was made smaller, taken for those of the camera's image, cost tens of degrees and metres.
"""

from __future__ import annotations

import numpy as np

from fgrecon.core.camera import CUT_OFF
from fgrecon.core.errors import InvalidInputError

Size = tuple[int, int]
"""Width and height in pixels."""

_ROUNDING = 1.0  # pixels by which the sides of a smaller picture are rounded
_SAME = 1.0, 1.0


def scale_between(stated: Size | None, actual: Size | None, field: str, *, scale: bool = False) -> tuple[float, float]:
    """What pixels (u, v) of an image of the stated size are multiplied by to be pixels of the actual one.

    Args:
        stated: The size that the file of keypoints or boxes states, or None.
        actual: The size of the picture, or of the camera's images; None where it is not known.
        field: What an error names.
        scale: Whether pixels may be scaled, where both have one shape.

    Raises:
        InvalidInputError: The sizes differ by more than rows and columns that were cut off, and scaling is not
            requested, or the shapes differ; names both sizes.
    """
    if stated is None or actual is None or same_image_size(stated, actual):
        return _SAME
    ratios = actual[0] / stated[0], actual[1] / stated[1]
    same_shape = _is_scaled(stated, actual)
    if same_shape and scale:
        return ratios
    whose = f"The picture or the camera has {actual[0]} x {actual[1]} pixels"
    fix = (
        f"{whose}, which is the same shape: scale to it (--scale-to-image, scale_to_image=True), or give that size."
        if same_shape
        else f"{whose}: give keypoints and boxes in its pixels, or the camera of that image."
    )
    raise InvalidInputError(field, f"an image of {stated[0]} x {stated[1]} pixels", fix)


def same_image_size(stated: Size, actual: Size) -> bool:
    """Whether two sizes are of one image, of which some rows and columns may be cut off."""
    return bool(np.abs(np.divide(stated, actual) - 1.0).max() <= CUT_OFF)


def _is_scaled(one: Size, other: Size) -> bool:
    """Whether one size is the other made smaller, its sides rounded."""
    small, large = sorted((one, other))
    ratios = np.divide(large, small)
    return bool(np.abs(np.divide(large, ratios[::-1]) - small).min() <= _ROUNDING)
