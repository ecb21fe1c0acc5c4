"""Results of a run's folder by name, for export."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from fgrecon.batch.parts import RUN, Parts
from fgrecon.batch.rows import id_in_image, reconstruction_of, table_of
from fgrecon.batch.schema import result_schema
from fgrecon.core.camera import Camera, Ground, lens_of
from fgrecon.core.category import Category
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.serialise import well_formed
from fgrecon.core.shape_prior import ShapePrior
from fgrecon.io.catalogue import load_prior
from fgrecon.io.export.formats import export_rows
from fgrecon.io.export.results import NamedResult, Surfaces, ground_of
from fgrecon.io.files import write_bytes
from fgrecon.io.json_fields import read_json

_FIX = "Give the folder as fgrecon wrote it."


def read_folder(folder: Path, prior: ShapePrior | str | Path | None = None) -> list[NamedResult]:
    """The results in a run's folder by file and row, those without a pose left out; surfaces are made from the prior.

    Args:
        folder: What `fgrecon batch` wrote.
        prior: The shape prior, where it is not where the run found it.

    Raises:
        InvalidInputError: It is no such folder, or the prior is not to be found.
    """
    if not (folder / RUN).is_file():
        raise InvalidInputError("results", str(folder), "Give a folder that `fgrecon batch` or `fgrecon run` wrote.")
    with well_formed(str(folder / RUN), _FIX):
        settings: Mapping[str, Any] = read_json(folder / RUN)["settings"]
        shape = load_prior(prior if prior is not None else settings.get("prior_file") or settings.get("prior", "car14"))
        surfaces, ground = Surfaces(settings, shape), ground_of(settings)
    with well_formed(str(folder), _FIX):
        rows = (row for row in Parts(folder).rows() if row["camera_T_object"] is not None)
        return [_named(row, shape.category, surfaces, ground) for row in sorted(rows, key=_place)]


def write_table(folder: Path, path: Path) -> Path:
    """All rows of a run's folder as one table, those that were refused included, by file and row.

    Args:
        path: `.parquet`, or `.csv`: numbers and texts alone, with the corners of the 2D box.
    """
    rows = sorted(Parts(folder).rows(), key=_place)
    if path.suffix.lower() == ".parquet":
        pq.write_table(table_of(rows), sink := io.BytesIO(), compression="zstd")
        return write_bytes(path, sink.getvalue())
    names = [entry.name for entry in result_schema() if not pa.types.is_list(entry.type)]
    return export_rows(path, [{name: row.get(name) for name in names} | _corners(row["box"]) for row in rows])


def _corners(box: Sequence[float] | None) -> dict[str, float | None]:
    return dict(zip(("x1", "y1", "x2", "y2"), box or (None,) * 4, strict=True))


def _place(row: Mapping[str, Any]) -> tuple[str, int, int]:
    """Where a row comes among the others, whenever it was solved: by its file, its number there, and its vehicle."""
    number = row["row_id"].removeprefix(row["source"]).removeprefix("#")
    return row["source"], int(number) if number.isdecimal() else 0, row["vehicle"] or 0


def _named(row: Mapping[str, Any], category: Category, surfaces: Surfaces, ground: Ground | None) -> NamedResult:
    result = reconstruction_of(row, category)
    assert result is not None
    size, box = row["image_size"], row["box"]
    return NamedResult(
        name=row["id"],
        result=surfaces.complete(result),
        box=None if box is None else np.array(box),
        image=row["row_id"] if row["id"] == id_in_image(row["row_id"], row["vehicle"]) else row.get("image") or "",
        row=row["row_id"],
        camera=Camera(
            np.array(row["camera_matrix"]).reshape(3, 3),
            image_size=None if size is None else (size[0], size[1]),
            focal_sigma=row.get("focal_sigma") or 0.0,
            **lens_of(row),
        ),
        ground=ground,
        score=row["score"],
        kind=row.get("kind"),
        track=row.get("track"),
    )
