"""Results as a table, one row per vehicle."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from typing import Any

from fgrecon.core.errors import InvalidInputError
from fgrecon.core.serialise import as_arrow
from fgrecon.core.text import whole_text
from fgrecon.io.export.results import NamedResult

_FORMULAS = ("=", "+", "-", "@", "\t", "\r")


def csv_text(results: Sequence[NamedResult]) -> str:
    """Comma-separated values with a header.

    A row has the scalars of `parquet_bytes`, then `lambda_1` and so on, then `<keypoint>_x`, `_y`, `_z` (object frame,
    metres), `_u`, `_v` (pixels), `_weight` and `_visibility`. Numbers read back to the last bit.

    Raises:
        InvalidInputError: The vehicles are of different categories or priors: their columns differ.
    """
    rows = [item.result.to_row(item.name) for item in results]
    if any(list(row) != list(rows[0]) for row in rows):
        raise InvalidInputError("results", "of different priors", "Write a table for each, or Parquet.")
    return csv_of_rows(rows)


def csv_of_rows(rows: Sequence[Mapping[str, Any]]) -> str:
    """Comma-separated values of rows, of which there is one at least and which have the same columns.

    A text that a spreadsheet would take for a formula has an apostrophe in front.
    """
    names = list(rows[0])
    lines = [_line(names), *(_line([_harmless(row[name]) for name in names]) for row in rows)]
    return whole_text("".join(lines))  # names of files need not be UTF-8


def _line(cells: Sequence[Any]) -> str:
    """A line with its end; cells with either half of a line's end are quoted, which Python 3.11 does for its own."""
    text = io.StringIO(newline="")
    csv.writer(text, lineterminator="\r\n").writerow(cells)
    return text.getvalue().removesuffix("\r\n") + "\n"


def _harmless(value: Any) -> Any:
    return f"'{value}" if isinstance(value, str) and value.startswith(_FORMULAS) else value


def parquet_bytes(results: Sequence[NamedResult]) -> bytes:
    """Parquet with lists for arrays, flattened row by row.

    Scalars: id, status, message, category, prior; rotation_y in radians; x, y, z of the origin in the camera frame and
    length, width, height in metres; the standard deviations of the pose's rotation (largest axis, radians) and
    translation (largest axis, metres), empty where not determined. Lists: camera_T_object (16), coefficients, keypoint
    names, wireframe (3 per keypoint), wireframe_uv (2 per keypoint), weights, visibility.
    """
    return parquet_of_rows([item.result.to_row(item.name, flat=False) for item in results])


def parquet_of_rows(rows: Sequence[Mapping[str, Any]]) -> bytes:
    """Parquet of rows with the same columns."""
    import pyarrow.parquet as pq

    sink = io.BytesIO()
    pq.write_table(as_arrow(rows), sink)
    return sink.getvalue()
