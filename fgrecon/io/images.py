"""Image files: reading photographs, writing pictures whole or not at all."""

from __future__ import annotations

import warnings
from contextlib import suppress
from io import BytesIO
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.camera import Camera
from fgrecon.core.checks import as_path
from fgrecon.core.errors import InvalidInputError
from fgrecon.io.arrays import LARGEST, largest_bytes
from fgrecon.io.exif import exif_camera
from fgrecon.io.files import write_bytes

IMAGES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".webp", ".ppm", ".pgm")
"""Endings of image files."""

UNREAD = (".heic", ".heif", ".hif", ".avif", ".jxl", ".dng", ".cr2", ".cr3", ".nef", ".arw")
"""Endings of photographs in formats that are not read."""


def refuse_unread(path: Path, field: str) -> None:
    """Refuse a photograph in a format that is not read, or a folder that has one; whatever else is passed over.

    Args:
        path: The file or folder.
        field: What the error is about.

    Raises:
        InvalidInputError: It is such; says what to do.
    """
    files = sorted(path.iterdir()) if path.is_dir() else [path]
    for file in files:
        if file.suffix.lower() in UNREAD and file.is_file():
            fix = "Its format is not read: save photographs as JPEG. `fgrecon reconstruct` takes them with --detect."
            raise InvalidInputError(field, str(file), fix)


def read_image(path: str | Path) -> NDArray[np.uint8]:
    """A photograph as (H, W, 3) RGB bytes, upright as its EXIF data say.

    Raises:
        InvalidInputError: The file cannot be read or is no image.
    """
    return decode_image(_content(path), str(path))


def read_photograph(path: str | Path, whole: tuple[int, int] | None = None) -> tuple[NDArray[np.uint8], Camera | None]:
    """A photograph as `read_image` gives it, and its camera where the EXIF data tell one (`fgrecon.io.exif`).

    Args:
        whole: (width, height) in pixels of the image that it is a part of, whose camera is meant then.

    Raises:
        InvalidInputError: The file cannot be read or is no image.
    """
    return decode_photograph(_content(path), str(path), whole)


def decode_photograph(
    content: bytes, name: str, whole: tuple[int, int] | None = None
) -> tuple[NDArray[np.uint8], Camera | None]:
    """The content of an image file as `read_photograph` gives it.

    Args:
        name: What it is called in an error.
        whole: As in `read_photograph`.

    Raises:
        InvalidInputError: It is no image.
    """
    image = decode_image(content, name)
    return image, exif_camera(content, *(whole or (image.shape[1], image.shape[0])))


def _content(path: str | Path) -> bytes:
    try:
        return as_path("image", path).read_bytes()
    except OSError as error:
        raise InvalidInputError("image", str(path), f"Give a file that can be read ({error.strerror}).") from error


def decode_image(content: bytes, name: str) -> NDArray[np.uint8]:
    """The content of an image file as (H, W, 3) RGB bytes; see `read_image`. An error names it.

    Raises:
        InvalidInputError: It is no image.
    """
    import cv2  # on use: importing fgrecon must not import OpenCV

    _check_size(content, name)
    coded, image = np.frombuffer(content, dtype=np.uint8), None
    with suppress(cv2.error):
        if content:
            image = cv2.imdecode(coded, cv2.IMREAD_COLOR | cv2.IMREAD_ANYDEPTH)
            if image is not None and image.dtype == np.uint16:
                image = _of_bytes(image)
            elif image is not None and image.dtype != np.uint8:
                image = cv2.imdecode(coded, cv2.IMREAD_COLOR)
    if image is None:
        raise InvalidInputError("image", name, "Give an image that OpenCV reads, such as PNG or JPEG.")
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2RGB, dst=image), dtype=np.uint8)


def _of_bytes(image: NDArray[np.uint16]) -> NDArray[np.uint8]:
    """The upper 8 of an image's bits, of which cameras use 8, 10, 12, 14 or all 16."""
    used = next(bits for bits in (8, 10, 12, 14, 16) if int(image.max()) < 1 << bits)
    return (image >> (used - 8)).astype(np.uint8)


def _check_size(content: bytes, name: str) -> None:
    """Refuse what its header says is too large, before it is decoded; what Pillow does not know is left to OpenCV."""
    from PIL import Image

    limit = largest_bytes() // 3
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # Pillow's own limit, which warns
            with Image.open(BytesIO(content)) as picture:
                width, height = picture.size
    except Image.DecompressionBombError:
        width = height = limit
    except Exception:  # noqa: BLE001  # Pillow promises no kind of error for damaged data
        return
    if width * height > limit:
        fix = f"Give at most {limit} pixels; the environment variable {LARGEST}, in bytes, raises that."
        raise InvalidInputError("image", f"{name} of more than that", fix)


def write_png(path: str | Path, image: NDArray[np.uint8]) -> Path:
    """Write an RGB image (H, W, 3) as PNG, whole or not at all.

    Raises:
        InvalidInputError: The file cannot be written.
    """
    import cv2

    return write_bytes(path, bytes(cv2.imencode(".png", np.ascontiguousarray(image[..., ::-1]))[1]))
