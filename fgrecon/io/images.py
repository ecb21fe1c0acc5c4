"""Image files: reading photographs, writing pictures whole or not at all."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.errors import InvalidInputError
from fgrecon.io.files import write_bytes

__all__ = ["decode_image", "read_image", "write_png"]


def read_image(path: str | Path) -> NDArray[np.uint8]:
    """A photograph as (H, W, 3) RGB bytes, in the pixel order of the file (EXIF orientation is not applied).

    Raises:
        InvalidInputError: The file cannot be read or is no image.
    """
    try:
        content = Path(path).read_bytes()
    except OSError as error:
        raise InvalidInputError("image", str(path), f"Give a file that can be read ({error.strerror}).") from error
    return decode_image(content, str(path))


def decode_image(content: bytes, name: str) -> NDArray[np.uint8]:
    """The content of an image file as (H, W, 3) RGB bytes; see `read_image`.

    Args:
        content: The file's bytes.
        name: What it is called in an error.

    Raises:
        InvalidInputError: It is no image.
    """
    import cv2  # on use: importing fgrecon must not import OpenCV

    flags = cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION
    image = cv2.imdecode(np.frombuffer(content, dtype=np.uint8), flags) if content else None
    if image is None:
        raise InvalidInputError("image", name, "Give an image that OpenCV reads, such as PNG or JPEG.")
    return np.ascontiguousarray(image[..., ::-1], dtype=np.uint8)


def write_png(path: str | Path, image: NDArray[np.uint8]) -> Path:
    """Write an RGB image (H, W, 3) as PNG, whole or not at all.

    Raises:
        InvalidInputError: The file cannot be written.
    """
    import cv2

    return write_bytes(path, bytes(cv2.imencode(".png", np.ascontiguousarray(image[..., ::-1]))[1]))
