"""Conversion of arrays, enumerations and dataclasses to plain values of JSON and tables, and back.

It is lossless, but for results in compact JSON: these are rounded (`rounded`) to more digits than anybody measures, far
fewer than doubles have.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import fields, is_dataclass
from enum import Enum
from functools import partial
from math import isqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.errors import InvalidInputError, MissingPackageError
from fgrecon.core.text import whole_text


def plain(value: Any) -> Any:
    """Lists, numbers and texts for JSON; NaN and infinity become texts."""
    if value is None or (isinstance(value, str | int) and not isinstance(value, Enum)):
        return value
    if isinstance(value, np.ndarray):
        kind, listed = value.dtype.kind, value.tolist()
        return listed if kind in "biu" or (kind == "f" and np.isfinite(value).all()) else plain(listed)
    if isinstance(value, Enum):
        return value.value
    if isinstance(value, float | np.floating):
        return float(value) if np.isfinite(value) else str(float(value))
    if isinstance(value, np.integer):
        return int(value)
    if isinstance(value, Mapping):
        return {key: plain(item) for key, item in value.items()}
    if isinstance(value, Sequence) and not isinstance(value, str):
        return [plain(item) for item in value]
    if is_dataclass(value):
        return {f.name: plain(getattr(value, f.name)) for f in fields(value)}
    return value


def finite(value: Any) -> Any:
    """The value with None for numbers that are not finite, also in mappings and sequences, which become lists."""
    if isinstance(value, float):
        return value if np.isfinite(value) else None
    if isinstance(value, Mapping):
        return {key: finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [finite(item) for item in value]
    return value


def array(value: Any) -> NDArray[np.float64]:
    """Numbers of any shape; NaN and infinity may be texts."""
    return np.array(value, dtype=np.float64)


def indices(value: Any) -> NDArray[np.int64]:
    """Integers of any shape."""
    return np.array(value, dtype=np.int64)


def pairs(value: Any) -> NDArray[np.int64]:
    """(P, 2) integers; JSON's empty list tells no shape."""
    return indices(value).reshape(-1, 2)


def square(value: Any) -> NDArray[np.float64]:
    """(n, n) numbers; JSON's empty list tells no shape."""
    entries = array(value)
    side = isqrt(entries.size)
    return entries.reshape(side, side)


def numbers(value: Mapping[str, Any]) -> dict[str, float]:
    """Numbers by name."""
    return {key: float(number) for key, number in value.items()}


@contextmanager
def well_formed(where: str, fix: str) -> Iterator[None]:
    """Read plain values; whatever is raised by values of other kinds than were written becomes one error.

    Args:
        where: What is read; goes before the fields that errors name.
        fix: What to give instead.

    Raises:
        InvalidInputError: Something was.
    """
    try:
        yield
    except InvalidInputError as error:
        raise InvalidInputError(f"{where}: {error.field}", error.value, error.fix) from error
    except (LookupError, TypeError, ValueError, AttributeError, OverflowError, RecursionError) as error:
        raise InvalidInputError(where, f"malformed: {error}", fix) from error


def as_pandas(rows: Sequence[Mapping[str, Any]]) -> Any:
    """Rows as a `pandas.DataFrame`.

    Raises:
        MissingPackageError: pandas is not installed.
    """
    try:
        import pandas as pd
    except ImportError as error:
        raise MissingPackageError("pandas", "A table as a pandas.DataFrame") from error
    return pd.DataFrame(_whole(rows))


def as_arrow(rows: Sequence[Mapping[str, Any]]) -> Any:
    """Rows as a `pyarrow.Table`."""
    import pyarrow as pa

    return pa.Table.from_pylist(_whole(rows))


def _whole(rows: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """The rows with texts that a table can hold: names of files need not be UTF-8."""
    return [{key: whole_text(value) if isinstance(value, str) else value for key, value in row.items()} for row in rows]


DECIMALS: Mapping[str, int] = {
    "camera_T_object": 9,
    "coefficients": 9,
    "offsets": 6,
    "wireframe": 6,
    "wireframe_uv": 3,
    "box_size": 6,
    "weights": 6,
    "visibility": 6,
    "facing_probability": 9,
    "box_excess": 6,
    "milliseconds": 3,
}
"""Digits behind the point, by field: nanometres of the pose, micrometres of keypoints, thousandths of pixels."""

SIGNIFICANT: Mapping[str, int] = {
    "sigmas": 6,
    "pose_covariance": 6,
    "coefficients_covariance": 6,
    "keypoint_covariance": 4,
    "size_covariance": 6,
    "energies": 9,
    "excess": 9,
    "probability": 6,
    "graph_gain": 9,
}
"""Significant digits of fields whose numbers are of any size."""


def rounded(name: str, value: Any) -> Any:
    """The plain value of a field (`fgrecon.core.serialise.plain`) with the digits that the field keeps.

    Texts, integers and what the tables do not name stay as they are; dictionaries inside lists go by their own names.
    """
    if name in DECIMALS:
        return _each(partial(round, ndigits=DECIMALS[name]), value)
    if name in SIGNIFICANT:
        return _each(partial(_significant, SIGNIFICANT[name]), value)
    if isinstance(value, list) and value and isinstance(value[0], dict):
        return [{key: rounded(key, item) for key, item in entry.items()} for entry in value]
    return value


def rounded_plain(name: str, value: Any) -> Any:
    """`rounded` of what is not plain yet; arrays as a whole, of which results have most."""
    digits = DECIMALS.get(name)
    cut = digits is not None or name in SIGNIFICANT
    is_array = isinstance(value, np.ndarray) and value.dtype.kind == "f" and value.ndim > 0 and value.size > 0
    if not (cut and is_array and np.isfinite(value).all()):
        return rounded(name, plain(value))
    numbers = value.ravel().tolist()
    if digits is not None:
        found = [round(number, digits) for number in numbers]
    else:
        words = " ".join([f"%.{SIGNIFICANT[name]}g"] * len(numbers)) % tuple(numbers)
        found = [float(word) for word in words.split()]
    for count in value.shape[:0:-1]:
        found = [found[start : start + count] for start in range(0, len(found), count)]
    return found


def _each(cut: Callable[[float], float], value: Any) -> Any:
    if isinstance(value, float):
        return cut(value)
    if isinstance(value, list):
        return [cut(item) if type(item) is float else _each(cut, item) for item in value]
    if isinstance(value, dict):
        return {key: _each(cut, item) for key, item in value.items()}
    return value


def _significant(digits: int, value: float) -> float:
    return float(f"{value:.{digits}g}")
