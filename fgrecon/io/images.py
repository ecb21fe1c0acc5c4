"""Image files: reading photographs with the camera of their EXIF data, writing pictures whole or not at all.

EXIF gives the focal length in terms of a 35 mm film frame, whose diagonal is 43.27 mm, or in millimetres together with
the pixels per millimetre of the sensor. Both are rounded, phones crop for their stabilisation, and what was cropped
later keeps its EXIF data; so the focal length has a spread, and where the picture's shape is not the one that EXIF
tells, nothing is believed.
"""

from __future__ import annotations

import math
import warnings
from contextlib import suppress
from dataclasses import replace
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.camera import Camera
from fgrecon.core.checks import as_path
from fgrecon.core.errors import InvalidInputError
from fgrecon.io.arrays import LARGEST, largest_bytes
from fgrecon.io.files import write_bytes

IMAGES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".webp", ".ppm", ".pgm")
"""Endings of image files."""

UNREAD = (".heic", ".heif", ".hif", ".avif", ".jxl", ".dng", ".cr2", ".cr3", ".nef", ".arw")
"""Endings of photographs in formats that are not read."""


def refuse_unread(path: Path, field: str) -> None:
    """Refuse a photograph in a format that is not read, or a folder that has one; whatever else is passed over."""
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
    """A photograph as `read_image` gives it, and its camera where the EXIF data tell one (`exif_camera`).

    Args:
        whole: (width, height) in pixels of the image that it is a part of, whose camera is meant then.
    """
    return decode_photograph(_content(path), str(path), whole)


def decode_photograph(
    content: bytes, name: str, whole: tuple[int, int] | None = None
) -> tuple[NDArray[np.uint8], Camera | None]:
    """The content of an image file as `read_photograph` gives it."""
    image = decode_image(content, name)
    return image, exif_camera(content, *(whole or (image.shape[1], image.shape[0])))


def _content(path: str | Path) -> bytes:
    try:
        return as_path("image", path).read_bytes()
    except OSError as error:
        raise InvalidInputError("image", str(path), f"Give a file that can be read ({error.strerror}).") from error


def decode_image(content: bytes, name: str) -> NDArray[np.uint8]:
    """The content of an image file as (H, W, 3) RGB bytes; see `read_image`. An error names it."""
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
    """Write an RGB image (H, W, 3) as PNG, whole or not at all."""
    import cv2

    return write_bytes(path, bytes(cv2.imencode(".png", np.ascontiguousarray(image[..., ::-1]))[1]))


EXIF_SIGMA = 0.05
"""Standard deviation of the logarithm of a focal length from EXIF."""

_DETAILS = 0x8769  # the directory that holds the following tags
_FOCAL_35_MM, _FOCAL_MM = 0xA405, 0x920A
_DENSITY, _DENSITY_UNIT = 0xA20E, 0xA210
_WIDTH, _HEIGHT = 0xA002, 0xA003
_UNITS = {2: 25.4, 3: 10.0, 4: 1.0}  # millimetres: inch, centimetre, millimetre
_FILM_DIAGONAL = math.hypot(36.0, 24.0)  # millimetres
_SHAPE = 0.02  # by which the sides' ratio may differ from the one that EXIF tells
_SHORTEST, _LONGEST = 0.2, 30.0  # believable focal lengths, in diagonals of the picture


def exif_camera(content: bytes, width: int, height: int) -> Camera | None:
    """The camera of a photograph, its principal point in the middle; None where its EXIF data do not tell.

    Args:
        width: Of the picture, upright, pixels.
    """
    tags = _tags(content)
    sides = _number(tags, _WIDTH), _number(tags, _HEIGHT)
    stated = sorted(side for side in sides if side)
    diagonal = math.hypot(width, height)
    if len(stated) == 2 and abs(stated[1] / stated[0] / (max(width, height) / min(width, height)) - 1.0) > _SHAPE:
        return None  # cropped
    film, length = _number(tags, _FOCAL_35_MM), _number(tags, _FOCAL_MM)
    density = _number(tags, _DENSITY) / _UNITS.get(int(_number(tags, _DENSITY_UNIT)), 25.4)
    focal = 0.0
    if film:
        focal = film / _FILM_DIAGONAL * diagonal
    elif length and density and len(stated) == 2:
        focal = length * density * diagonal / math.hypot(*stated)
    if not _SHORTEST <= focal / diagonal <= _LONGEST:
        return None
    camera = Camera.of([focal, focal, (width - 1) / 2, (height - 1) / 2])
    return replace(camera, image_size=(width, height), focal_sigma=EXIF_SIGMA)


def _tags(content: bytes) -> dict[int, Any]:
    from PIL import Image  # on use: importing fgrecon must be fast

    try:
        with Image.open(BytesIO(content)) as picture:
            return dict(picture.getexif().get_ifd(_DETAILS))
    except Exception:  # noqa: BLE001  # Pillow promises no kind of error for damaged data, and without it we go on
        return {}


def _number(tags: dict[int, Any], tag: int) -> float:
    """A positive number, or 0 where there is none."""
    try:
        value = float(tags.get(tag, 0.0))
    except (TypeError, ValueError, ZeroDivisionError, OverflowError):
        return 0.0
    return value if math.isfinite(value) and value > 0.0 else 0.0
