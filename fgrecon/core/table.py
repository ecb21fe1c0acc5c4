"""Rows of results as tables of other libraries, imported on use."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from fgrecon.core.errors import MissingPackageError

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
    return pd.DataFrame(list(rows))


def as_arrow(rows: Sequence[Mapping[str, Any]]) -> Any:
    """Rows as a `pyarrow.Table`."""
    import pyarrow as pa

    return pa.Table.from_pylist(list(rows))
