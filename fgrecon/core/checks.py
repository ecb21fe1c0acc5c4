"""Validation of array arguments: one place that turns bad input into `InvalidInputError`."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from os import PathLike
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from factors.checks import has_shape, shape_words
from fgrecon.core.errors import InvalidInputError

_NUMBERS = (
    "biufO"  # numpy's kinds; an array of objects may hold numbers, and whether it does shows when it is converted
)
_NUMBER = _NUMBERS.replace("b", "")  # True is no number of metres

Kept = TypeVar("Kept", bound=NDArray[Any])

RIGID = 1e-3  # by so much a rotation may fail to be one: calibrations and text have few digits
_LAST_ROW = 1e-6  # by so much 0 0 0 1 may be off
_LATEST_S = 1e11  # that a time may be: the year 5138, or March 1973 in milliseconds


def as_shape(field: str, value: ArrayLike, shape: tuple[int | None, ...], fix: str = "") -> NDArray[np.float64]:
    """Convert to a float64 array of the given shape (`None` matches any length); values are not checked.

    What a masked array hides is NaN: not measured.

    Raises:
        InvalidInputError: `value` is not numeric or has another shape.
    """
    array = _numbers(field, value, shape, fix)
    if not has_shape(array.shape, shape):
        raise InvalidInputError(field, f"shape {array.shape}", fix or f"Give an array of shape {shape_words(shape)}.")
    return array


def _numbers(field: str, value: ArrayLike, shape: tuple[int | None, ...], fix: str) -> NDArray[np.float64]:
    """The numbers of any shape; `shape` is that of the error's fix."""
    if value is None:  # which numpy takes for NaN
        raise InvalidInputError(field, value, fix or f"Give numbers in an array of shape {shape_words(shape)}.")
    try:
        given = np.asarray(_detached(value))
        if given.dtype.kind not in (_NUMBERS if shape else _NUMBER):  # text, dates; complex numbers would lose a part
            raise TypeError(f"{given.dtype}")
        array = hidden_as_nan(value, given.astype(np.float64, copy=False))
    except (TypeError, ValueError, OverflowError, RuntimeError) as error:  # the last of sparse tensors
        fix = fix or f"Give numbers in an array of shape {shape_words(shape)}."
        raise InvalidInputError(field, text_named(value), fix) from error
    return array


def text_named(value: Any) -> Any:
    """A value for an error: a text says that it is one, since it may look like what is wanted, such as "1.65"."""
    return f'the text "{value}"' if isinstance(value, str) else value


def _detached(value: Any) -> Any:
    """A tensor without its gradient, in the memory that numpy reads; anything else as it is."""
    for step in ("detach", "cpu"):
        value = getattr(value, step, lambda same=value: same)()
    return value


def hidden_as_nan(value: Any, numbers: NDArray[np.float64]) -> NDArray[np.float64]:
    """The numbers of a value, NaN where it is a masked array that hides them: not measured."""
    return np.where(np.ma.getmaskarray(value), np.nan, numbers) if isinstance(value, np.ma.MaskedArray) else numbers


def as_rows(field: str, value: ArrayLike, width: int, fix: str = "") -> NDArray[np.float64]:
    """(N, width) rows of numbers; the numbers of one row alone are a row, and none at all are no rows.

    Raises:
        InvalidInputError: As `as_shape`.
    """
    numbers = _numbers(field, value, (None, width), fix)
    return as_shape(field, numbers.reshape(-1, width) if numbers.size % width == 0 else numbers, (None, width), fix)


def as_vectors(field: str, value: ArrayLike, width: int, fix: str = "") -> NDArray[np.float64]:
    """Convert to a float64 array (..., width), such as one point or many in any order; values are not checked.

    Raises:
        InvalidInputError: As `as_shape`.
    """
    array = _numbers(field, value, (width,), fix)
    if array.shape[-1:] != (width,):
        raise InvalidInputError(field, f"shape {array.shape}", fix or f"Give an array of shape (..., {width}).")
    return array


def as_either(field: str, value: ArrayLike, shapes: Sequence[tuple[int | None, ...]], fix: str) -> NDArray[np.float64]:
    """Convert to a float64 array of one of some shapes; values are not checked.

    Raises:
        InvalidInputError: `value` is not numeric or has none of them.
    """
    array = _numbers(field, value, shapes[0], fix)
    if not any(has_shape(array.shape, shape) for shape in shapes):
        raise InvalidInputError(field, f"shape {array.shape}", fix)
    return array


def as_finite(field: str, value: ArrayLike, shape: tuple[int | None, ...], fix: str = "") -> NDArray[np.float64]:
    """Like `as_shape`, and every element must be finite.

    Raises:
        InvalidInputError: Also where an element is NaN or infinite.
    """
    array = as_shape(field, value, shape, fix)
    if not np.isfinite(array).all():
        where: Any = tuple(int(i) for i in np.argwhere(~np.isfinite(array))[0])
        place = f"[{', '.join(map(str, where))}]" if where else ""
        raise InvalidInputError(field + place, float(array[where]), fix or "Give finite numbers only.")
    return array


CORNERS = "Give two corners x1, y1, x2, y2 in pixels, no width and height."
"""What to give for a 2D box."""


def check_corners(field: str, boxes: NDArray[np.float64], least: float = 0.0) -> None:
    """Refuse 2D boxes (..., 4) that have no size, as one of width and height has, or a side of less than some pixels.

    Raises:
        InvalidInputError: For the first of them.
    """
    for box in boxes.reshape(-1, 4):
        size = box[2:] - box[:2]
        if not ((size > 0.0) & (size >= least)).all():
            raise InvalidInputError(field, box.tolist(), CORNERS)


def as_time(value: ArrayLike) -> float:
    """The time of a frame, seconds by any clock.

    Raises:
        InvalidInputError: It is no finite number, or a clock's milliseconds or nanoseconds: later than any year 5000.
    """
    time = float(as_finite("time", value, (), "Give seconds."))
    if abs(time) > _LATEST_S:
        fix = "Give seconds: of a clock's milliseconds a thousandth, of nanoseconds a billionth."
        raise InvalidInputError("time", time, fix)
    return time


def own(array: Kept) -> Kept:
    """A read-only copy, for an object to keep: nobody changes it by writing into what was given, or into the object.

    What is such a copy already is taken as it is.
    """
    if not array.flags.writeable and array.base is None:
        return array
    kept = array.copy(order="C")
    kept.flags.writeable = False
    return kept


def as_rigid(field: str, value: ArrayLike, tolerance: float = RIGID) -> NDArray[np.float64]:
    """A rigid motion as a matrix (4, 4), as it is given.

    Args:
        field: Its name.
        value: [R t; 0 0 0 1].
        tolerance: By how much an element of R R^T may differ from the identity's.

    Raises:
        InvalidInputError: It has another shape, an element is not finite, R is no rotation (it mirrors, say), or the
            last row is another.
    """
    fix = "Give a rigid motion [R t; 0 0 0 1] with a rotation R (3, 3)."
    matrix = as_finite(field, value, (4, 4), fix)
    rotation, last = matrix[:3, :3], np.abs(matrix[3] - (0.0, 0.0, 0.0, 1.0)).max()
    with np.errstate(over="ignore", invalid="ignore"):  # of enormous numbers, which no tolerance takes
        off = np.abs(rotation @ rotation.T - np.eye(3)).max()
    if not off <= tolerance or np.linalg.det(rotation) < 0.0 or last > _LAST_ROW:
        raise InvalidInputError(field, matrix.tolist(), fix)
    return matrix


def as_quaternion(field: str, value: NDArray[np.float64]) -> NDArray[np.float64]:
    """A unit quaternion (4,) as it is given, to the digits of text.

    Raises:
        InvalidInputError: It is of another length.
    """
    with np.errstate(over="ignore"):  # of enormous numbers
        length = float(np.linalg.norm(value))
    if not abs(length - 1.0) < RIGID:
        raise InvalidInputError(field, value.tolist(), "Give a unit quaternion w, x, y, z.")
    return value


def as_size(field: str, value: NDArray[np.float64]) -> NDArray[np.float64]:
    """Sizes (3,) of a box as they are given, metres.

    Raises:
        InvalidInputError: One is not above 0.
    """
    if not (value > 0.0).all():
        raise InvalidInputError(field, value.tolist(), "Give length, width and height in metres, above 0.")
    return value


def as_instance(field: str, value: Any, kind: type[Any]) -> Any:
    """The value as it is, which is of a class.

    Raises:
        InvalidInputError: It is of another.
    """
    if not isinstance(value, kind):
        raise InvalidInputError(field, value, f"Give a `{kind.__name__}`.")
    return value


def as_flag(field: str, value: Any) -> bool:
    """True or False.

    Raises:
        InvalidInputError: It is neither.
    """
    if not isinstance(value, bool | np.bool_):
        raise InvalidInputError(field, text_named(value), "Give True or False.")
    return bool(value)


def as_list(field: str, value: Any, kind: type | None = None, *, gaps: bool = False) -> list[Any]:
    """What a sequence, or anything else that is gone through once, holds.

    Args:
        field: Its name.
        kind: Class of its members; None where they are checked elsewhere.
        gaps: Whether None may be among them.

    Raises:
        InvalidInputError: It is no sequence (a text is none), or a member is of another class.
    """
    of = "" if kind is None else f" of `{kind.__name__}`"
    fix = f"Give a sequence{of}{', with None where there is none' if gaps else ''}."
    if isinstance(value, str | bytes | Mapping) or not isinstance(value, Iterable):
        raise InvalidInputError(field, value, fix)
    members = list(value)
    for number, member in enumerate(members):
        if kind is not None and not isinstance(member, kind) and not (gaps and member is None):
            raise InvalidInputError(f"{field}[{number}]", member, fix)
    return members


def as_path(field: str, value: Any) -> Path:
    """The path of a file.

    Raises:
        InvalidInputError: It is neither a path nor a text.
    """
    if not isinstance(value, str | PathLike):
        raise InvalidInputError(field, value, "Give the path of a file.")
    return Path(value)


def one_word(field: str, value: Any) -> str:
    """The text as it is, which may stand between spaces in a line of a file.

    Raises:
        InvalidInputError: It is no text, is empty, or has a space in it.
    """
    if not isinstance(value, str) or value.split() != [value]:
        raise InvalidInputError(field, value, "Give one word without spaces.")
    return value


def array_of(value: Any, field: str) -> NDArray[np.float64]:
    """Numbers of an array or of a tensor on any device.

    Raises:
        InvalidInputError: It is none of numbers.
    """
    try:
        return hidden_as_nan(value, np.asarray(_detached(value), dtype=np.float64))
    except (TypeError, ValueError) as error:
        raise InvalidInputError(field, value, "Give an array of numbers.") from error
