"""Camera of a photograph by its EXIF data: the focal length.

EXIF gives the focal length in terms of a 35 mm film frame, whose diagonal is 43.27 mm, or in millimetres together with
the pixels per millimetre of the sensor. Both are rounded, phones crop for their stabilisation, and what was cropped
later keeps its EXIF data; so the focal length has a spread, and where the picture's shape is not the one that EXIF
tells, nothing is believed.
"""

from __future__ import annotations

import math
from dataclasses import replace
from io import BytesIO
from typing import Any

from fgrecon.core.camera import Camera

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
        height: Of the picture, upright, pixels.
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
