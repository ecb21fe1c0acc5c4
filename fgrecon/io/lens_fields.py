"""The lens and the image's size beside a camera matrix, by the names that calibration files have for them.

A field that looks like one of them and is none of these names is refused: a lens that is passed over without a word
costs degrees and metres. So do pixels of a picture that was made smaller: a size that a file states is held against
that of the picture or of the camera's images.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.camera import CUT_OFF
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.lens import FISHEYE, MEI, OPENCV
from fgrecon.io.json_fields import Fields, numbers

DISTORTION = frozenset(
    [
        "distortioncoefficients",
        "distortioncoefficient",
        "distortioncoeffs",
        "distortioncoeff",
        "distortioncoefs",
        "distortioncoef",
        "distcoeffs",
        "distcoeff",
        "distcoefs",
        "distcoef",
        "distortion",
        "dist",
        "d",
    ]
)
"""Names of the coefficients in OpenCV's order, in small letters and without underscores."""

WIDTHS = frozenset(["imagewidth", "imgwidth", "width"])
HEIGHTS = frozenset(["imageheight", "imgheight", "height"])
SIZES = frozenset(["imagesize", "imgsize", "resolution", "size"])
"""Names of both as one list (width, height)."""

MODELS = frozenset(["distortionmodel", "distortiontype", "cameramodel", "cameratype", "projectionmodel", "lensmodel"])
FISHEYES = frozenset(["fisheyemodel", "isfisheye", "fisheye"])
PINHOLE = frozenset(
    [
        "plumbbob",
        "rationalpolynomial",
        "radtan",
        "radialtangential",
        "pinhole",
        "perspective",
        "opencv",
        "brownconrady",
        "none",
    ]
)
"""Lens models that OpenCV's coefficients describe."""

LENSES = {
    **dict.fromkeys(PINHOLE, OPENCV),
    **dict.fromkeys(["fisheye", "opencvfisheye", "equidistant", "kannalabrandt", "kannalabrandt8"], FISHEYE),
    "mei": MEI,
}
"""What the coefficients are of, by the names of models."""

UNSOLVED = "Solved are pinholes, fisheye (Kannala-Brandt) and mei. Undistort points and image and give that camera."
_SINGLE = frozenset(["k1", "k2", "k3", "k4", "k5", "k6", "p1", "p2"])  # a coefficient by itself
_PARTS = "distort", "fisheye", "lens", "coef", "resolution", "imagesize"
_LIKE = 0.84  # share of letters in common (difflib) from which on a name is taken for a misspelt one; not tuned


def _bare(name: object) -> str:
    return "".join(letter for letter in str(name).lower() if letter.isalnum())


def _named(data: Mapping[str, Any], names: frozenset[str]) -> list[str]:
    """The fields that have one of these names and a value, in the file's order."""
    return [field for field, value in data.items() if _bare(field) in names and value is not None]


def read_lens(fields: Fields) -> dict[str, Any]:
    """The lens as `fgrecon.core.camera.Camera` has it, `distortion` (N,) and `distortion_model`; empty for a pinhole.

    Raises:
        InvalidInputError: The lens is none that is solved, two fields have coefficients, or they are no numbers; names
            the field.
    """
    fisheye = any(fields.data[field] not in (0, False, "0", "false") for field in _named(fields.data, FISHEYES))
    model = FISHEYE if fisheye else OPENCV
    loose = [field for field in _named(fields.data, frozenset(["model"])) if _bare(fields.data[field]) in LENSES]
    for field in [*_named(fields.data, MODELS), *loose]:  # `model` may be that of a network as well
        named = _bare(fields.data[field])
        if named and named not in LENSES:
            raise InvalidInputError(f"{fields.where}{field}", fields.data[field], UNSOLVED)
        model = LENSES.get(named, OPENCV) if model == OPENCV else model
    coefficients = _coefficients(fields)
    if model != OPENCV and coefficients is None:
        raise InvalidInputError(f"{fields.where}distortion", "nothing", f"Give the coefficients of {model}.")
    return {} if coefficients is None else {"distortion": coefficients, "distortion_model": model}


def listed_numbers(fields: Fields, field: str) -> tuple[list[Any], str]:
    """The numbers of a field, which is a list or one of them, or has these in `data`, and what to call them."""
    value, place = fields.data[field], f"{fields.where}{field}"
    if isinstance(value, Mapping):
        value, place = value.get("data"), f"{place}.data"
    if isinstance(value, int | float) and not isinstance(value, bool):
        value = [value]
    if not isinstance(value, list):
        raise InvalidInputError(place, "nothing" if value is None else value, "Give a list of numbers.")
    return value, place


def _coefficients(fields: Fields) -> NDArray[np.float64] | None:
    """The coefficients (N,) of whatever lens; None where no field has any."""
    found = _named(fields.data, DISTORTION)
    if not found:
        return None
    if len(found) > 1:
        raise InvalidInputError(f"{fields.where}{found[1]}", "a second lens", f"Give it or {found[0]}.")
    values, place = listed_numbers(fields, found[0])
    flat = [as_number(x) for value in values for x in (value if isinstance(value, list) else [value])]
    return numbers(flat, (len(flat),), place) if flat else None


def read_size(fields: Fields) -> tuple[int, int] | None:
    """Width and height of the image in pixels, or None where no field has them.

    Raises:
        InvalidInputError: They are no whole numbers from 1, or one is missing; names the field.
    """
    both = _named(fields.data, SIZES)
    if both:
        values = fields.data[both[0]]
        rows = values.get("data") if isinstance(values, Mapping) else values
        pair = numbers([as_number(x) for x in rows] if isinstance(rows, list) else rows, (2,), fields.where + both[0])
        width, height, name = float(pair[0]), float(pair[1]), both[0]
    else:
        wide, high = _named(fields.data, WIDTHS), _named(fields.data, HEIGHTS)
        if not wide and not high:
            return None
        if not wide or not high:
            field = (wide or high)[0]
            raise InvalidInputError(f"{fields.where}{field}", fields.data[field], "Give width and height.")
        width, height = (
            float(numbers(as_number(fields.data[field]), (), f"{fields.where}{field}")) for field in (wide[0], high[0])
        )
        name = wide[0]
    if width == height == 0.0:  # ROS's for "not known"
        return None
    if min(width, height) < 1 or width % 1 or height % 1:
        raise InvalidInputError(f"{fields.where}{name}", [width, height], "Give width and height in pixels.")
    return int(width), int(height)


def check_unused(fields: Fields, used: Iterable[str] = ()) -> None:
    """Refuse a field that looks like a lens, a size or a lens model and is not read as one.

    Args:
        used: Names of fields that are read, or known to be of no matter.
    """
    known = DISTORTION | WIDTHS | HEIGHTS | SIZES | MODELS | FISHEYES
    passed = {_bare(name) for name in used} | known
    for field, value in fields.data.items():
        bare = _bare(field)
        if value is None or bare in passed:
            continue
        like = difflib.get_close_matches(bare, [name for name in known if len(name) > len("width")], 1, _LIKE)
        if bare in _SINGLE or like or any(part in bare for part in _PARTS):
            fix = (
                "It looks like a lens or a size of the image, and no such name is read. Give distortion_coefficients "
                "(OpenCV's order), image_width and image_height, or take it out."
            )
            raise InvalidInputError(f"{fields.where}{field}", value, fix)


def as_number(value: Any) -> Any:
    """A number that YAML takes for a text: 1e-05 has no dot."""
    if isinstance(value, str):
        try:
            return float(value)
        except ValueError:
            return value
    return value


Size = tuple[int, int]
"""Width and height in pixels."""

_ROUNDING = 1.0  # pixels by which the sides of a smaller picture are rounded
_SAME = 1.0, 1.0


def scale_between(stated: Size | None, actual: Size | None, field: str, *, scale: bool = False) -> tuple[float, float]:
    """What pixels (u, v) of an image of the stated size are multiplied by to be pixels of the actual one.

    Args:
        stated: The size that the file of keypoints or boxes states, or None.
        actual: The size of the picture, or of the camera's images; None where it is not known.
        scale: Whether pixels may be scaled, where both have one shape.

    Raises:
        InvalidInputError: The sizes differ by more than rows and columns that were cut off, and scaling is not
            requested, or the shapes differ; names both sizes.
    """
    if stated is None or actual is None:
        return _SAME
    if np.abs(np.divide(stated, actual) - 1.0).max() <= CUT_OFF:  # one image, of which some rows may be cut off
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


def _is_scaled(one: Size, other: Size) -> bool:
    """Whether one size is the other made smaller, its sides rounded."""
    small, large = sorted((one, other))
    ratios = np.divide(large, small)
    return bool(np.abs(np.divide(large, ratios[::-1]) - small).min() <= _ROUNDING)
