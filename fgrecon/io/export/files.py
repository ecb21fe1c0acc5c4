"""Chooses the kind of file by the ending of its name."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from fgrecon.core.errors import InvalidInputError
from fgrecon.io.export.kitti import kitti_text
from fgrecon.io.export.mesh import glb_bytes, ply_bytes
from fgrecon.io.export.results import NamedResult
from fgrecon.io.export.table import csv_of_rows, csv_text, parquet_bytes, parquet_of_rows
from fgrecon.io.files import check_ending, write_bytes

__all__ = ["FORMATS", "TABLE_FORMATS", "check_format", "export", "export_rows"]

_WRITERS: dict[str, Callable[[Sequence[NamedResult]], bytes]] = {
    "ply": ply_bytes,
    "glb": glb_bytes,
    "csv": lambda results: csv_text(results).encode(),
    "parquet": parquet_bytes,
    "txt": lambda results: kitti_text(results).encode(),
}

FORMATS = tuple(_WRITERS)
"""File types that `export` writes, by the ending of the name."""

_TABLES: dict[str, Callable[[Sequence[Mapping[str, Any]]], bytes]] = {
    "csv": lambda rows: csv_of_rows(rows).encode(),
    "parquet": parquet_of_rows,
}

TABLE_FORMATS = tuple(_TABLES)
"""Those of them that are tables, which `export_rows` writes."""


def check_format(path: str | Path) -> str:
    """The ending of the name, in lower case.

    Raises:
        InvalidInputError: Nothing is written with that ending.
    """
    return check_ending(path, FORMATS)


def export(path: str | Path, results: Sequence[NamedResult]) -> Path:
    """Write results to a file, whole or not at all; the ending of the name chooses the type (see `FORMATS`).

    Args:
        path: `.ply` or `.glb`: surfaces and wireframes in the camera frame; `.csv` or `.parquet`: one row per vehicle;
            `.txt`: KITTI's result lines.
        results: Vehicles; those without a pose are left out, except in tables.

    Returns:
        The path written to.

    Raises:
        InvalidInputError: Another ending, the file cannot be written, or there is nothing to write.
    """
    kind = check_format(path)
    if not results:
        raise InvalidInputError("results", "none", "Give at least one reconstructed vehicle.")
    return write_bytes(path, _WRITERS[kind](results))


def export_rows(path: str | Path, rows: Sequence[Mapping[str, Any]]) -> Path:
    """Write rows with the same columns as a table, whole or not at all; `.csv` or `.parquet` by the ending.

    Raises:
        InvalidInputError: Another ending, the file cannot be written, or there is no row.
    """
    kind = check_ending(path, TABLE_FORMATS)
    if not rows:
        raise InvalidInputError("rows", "none", "Give at least one.")
    return write_bytes(path, _TABLES[kind](rows))
