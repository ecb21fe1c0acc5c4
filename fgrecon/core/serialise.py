"""Lossless conversion of arrays, enumerations and dataclasses to plain values of JSON and tables, and back."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import fields, is_dataclass
from enum import Enum
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
