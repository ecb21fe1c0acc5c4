"""Validation of what factors are built from (what they compute is checked in `factors.guard`)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from factors.errors import InvalidInputError

_LARGE = 1e100
"""Squares of numbers that are larger are soon beyond what floats hold."""


def finite_array(field: str, value: ArrayLike, shape: tuple[int | None, ...]) -> NDArray[np.float64]:
    """A C-contiguous float64 copy of `value` of a shape (`None` matches any length) with finite elements.

    Raises:
        InvalidInputError: It is not numeric, has another shape, or holds NaN or infinite elements.
    """
    try:
        array = np.array(value, dtype=np.float64, order="C")
    except (TypeError, ValueError) as error:
        raise InvalidInputError(field, value, f"Give numbers in an array of shape {shape_words(shape)}.") from error
    if not has_shape(array.shape, shape):
        raise InvalidInputError(field, f"shape {array.shape}", f"Give an array of shape {shape_words(shape)}.")
    if not np.isfinite(array).all():
        raise InvalidInputError(field, array[~np.isfinite(array)][0], "Give finite numbers only.")
    return array


def has_shape(shape: tuple[int, ...], expected: tuple[int | None, ...]) -> bool:
    """Whether a shape is the expected one, of which `None` matches any length."""
    return shape == expected or (
        len(shape) == len(expected) and all(w is None or n == w for n, w in zip(shape, expected, strict=True))
    )


def shape_words(shape: tuple[int | None, ...]) -> str:
    """A expected shape for an error's text."""
    return "(" + ", ".join("any" if n is None else str(n) for n in shape) + ")"


def index_array(field: str, value: ArrayLike, size: int, at_least: int = 1) -> NDArray[np.intp]:
    """`value` as a vector of distinct indices below `size`, at least `at_least` of them.

    Raises:
        InvalidInputError: It holds no integers, too few, one twice, or one out of range.
    """
    array = np.asarray(value)
    if array.ndim != 1 or len(array) < at_least or array.dtype.kind not in "iu":
        raise InvalidInputError(field, value, f"Give at least {at_least} keypoint indices.")
    if array.min() < 0 or array.max() >= size or len(np.unique(array)) != len(array):
        raise InvalidInputError(field, array.tolist(), f"Give distinct indices from 0 to {size - 1}.")
    return array.astype(np.intp)


def unit_vector(field: str, value: ArrayLike) -> NDArray[np.float64]:
    """`value` (3,) scaled to length 1.

    Raises:
        InvalidInputError: It is no finite 3-vector, or has no length.
    """
    vector = finite_array(field, value, (3,))
    largest = np.abs(vector).max()
    if largest > _LARGE:
        vector = vector / largest
    length = float(np.linalg.norm(vector))
    if length < 1e-9:
        raise InvalidInputError(field, vector.tolist(), "Give a vector of length above zero.")
    return vector / length
