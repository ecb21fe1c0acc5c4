"""Results as a table, one row per vehicle."""

from __future__ import annotations

import csv
import io
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from fgrecon.core.errors import InvalidInputError
from fgrecon.core.serialise import as_arrow
from fgrecon.core.text import whole_text
from fgrecon.io.export.results import NamedResult
from fgrecon.io.files import replacing

AddRows = Callable[[Sequence[Mapping[str, Any]]], None]

_ROWS = 500
"""Rows of Python's objects that wait to become columns."""

_FORMULAS = ("=", "+", "-", "@", "\t", "\r")


def csv_text(results: Sequence[NamedResult]) -> str:
    """Comma-separated values with a header.

    A row has the scalars of `parquet_bytes`, then `lambda_1` and so on, then `<keypoint>_x`, `_y`, `_z` (object frame,
    metres), `_u`, `_v` (pixels), `_weight` and `_visibility`. Numbers read back to the last bit.

    Raises:
        InvalidInputError: The vehicles are of different categories or priors: their columns differ.
    """
    rows = [_row(item, flat=True) for item in results]
    if any(list(row) != list(rows[0]) for row in rows):
        raise InvalidInputError("results", "of different priors", "Write a table for each, or Parquet.")
    return csv_of_rows(rows)


def csv_of_rows(rows: Sequence[Mapping[str, Any]], *, header: bool = True) -> str:
    """Comma-separated values of rows, of which there is one at least and which have the same columns.

    A text that a spreadsheet would take for a formula has an apostrophe in front.
    """
    names = list(rows[0])
    lines = [_line([_harmless(row[name]) for name in names]) for row in rows]
    return whole_text("".join([_line(names), *lines] if header else lines))  # names of files need not be UTF-8


def _line(cells: Sequence[Any]) -> str:
    """A line with its end; cells with either half of a line's end are quoted, which Python 3.11 does for its own."""
    text = io.StringIO(newline="")
    csv.writer(text, lineterminator="\r\n").writerow(cells)
    return text.getvalue().removesuffix("\r\n") + "\n"


def _harmless(value: Any) -> Any:
    return f"'{value}" if isinstance(value, str) and value.startswith(_FORMULAS) else value


def parquet_bytes(results: Sequence[NamedResult]) -> bytes:
    """Parquet with lists for arrays, flattened row by row.

    Scalars: id; image, kind, score, track, and x1, y1, x2, y2 of the 2D box in pixels, empty where not known; status,
    message, category, prior; rotation_y in radians; x, y, z of the origin in the camera frame and length, width, height
    in metres; the standard deviations of the pose's rotation (largest axis, radians) and
    translation (largest axis, metres), empty where not determined. Lists: camera_T_object (16), coefficients, keypoint
    names, wireframe (3 per keypoint), wireframe_uv (2 per keypoint), weights, visibility.
    """
    import pyarrow.parquet as pq

    sink = io.BytesIO()
    pq.write_table(as_arrow([_row(item, flat=False) for item in results]), sink)
    return sink.getvalue()


def _row(item: NamedResult, *, flat: bool) -> dict[str, Any]:
    """The row of a vehicle: what was given of it behind its id, then the result's columns."""
    corners = (None,) * 4 if item.box is None else item.box.tolist()
    given = {"image": item.image or None, "kind": item.kind, "score": item.score, "track": item.track}
    return {
        "id": item.name,
        **given,
        **dict(zip(("x1", "y1", "x2", "y2"), corners, strict=True)),
        **item.result.to_row(item.name, flat=flat),
    }


@contextmanager
def csv_file(path: Path) -> Iterator[AddRows]:
    """What adds rows to comma-separated values; there must be one in the end."""
    with replacing(path) as part, part.open("wb") as file:

        def add(rows: Sequence[Mapping[str, Any]]) -> None:
            if rows:
                file.write(csv_of_rows(rows, header=not file.tell()).encode())

        yield add


@contextmanager
def parquet_file(path: Path) -> Iterator[AddRows]:
    """What adds rows to Parquet; there must be one in the end. Kept as columns, which take little room, until then."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    with replacing(path) as part:
        tables: list[Any] = []
        waiting: list[Mapping[str, Any]] = []

        def add(rows: Sequence[Mapping[str, Any]], most: int = _ROWS) -> None:
            waiting.extend(rows)
            if len(waiting) > most:
                tables.append(as_arrow(waiting))
                waiting.clear()

        yield add
        add((), most=0)
        with pa.OSFile(os.fsencode(part), "wb") as sink:
            # A column may have no value in the first of them, and numbers without a fraction there.
            pq.write_table(pa.concat_tables(tables, promote_options="permissive"), sink)
