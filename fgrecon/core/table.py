"""Rows of results as tables of other libraries, imported on use."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from fgrecon.core.errors import MissingPackageError
from fgrecon.core.text import whole_text

__all__ = ["as_arrow", "as_pandas"]


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
