"""A run's folder of Parquet parts, which grows while it goes on, each written whole or not at all; and its results."""

from __future__ import annotations

import io
import json
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from time import monotonic
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from fgrecon.batch.rows import id_in_image, reconstruction_of, table_of
from fgrecon.batch.schema import ERROR, FORMAT, REFUSED, result_schema
from fgrecon.core.camera import Camera, Ground, lens_of
from fgrecon.core.category import Category
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.serialise import well_formed
from fgrecon.core.shape_prior import ShapePrior
from fgrecon.io.catalogue import load_prior
from fgrecon.io.export.formats import export_rows
from fgrecon.io.export.results import NamedResult, Surfaces, ground_of
from fgrecon.io.files import MADE_AGAIN, replacing, stored, write_bytes, write_text
from fgrecon.io.isolated import Isolated
from fgrecon.io.json_fields import parse_json, read_json

RUN = "_run.json"
"""What the run is: readers of Parquet folders leave names alone that begin with an underscore."""

RECORDS = "records"
"""Folder within that of a video's run, whose parts are no results."""

_AT_ONCE = 512
"""Rows of a part that are looked at together."""

_ROWS, _SECONDS = 4096, 10.0
"""A part is written when it has so many rows, or so much time has passed since the last one."""


_LATE = 600.0  # seconds after which a part that is still being read is damaged


class RowOutcome(NamedTuple):
    """What a row of results tells of how it went; its error, where it has one, as the columns have it."""

    status: str
    error_type: str | None = None
    error_field: str | None = None
    error: str | None = None


class Parts:
    """The parts of a folder: what is done already, and what is added."""

    def __init__(self, folder: Path, schema: Any = None) -> None:
        """Look at a folder.

        Args:
            schema: Columns of its tables, `row_id` among them; None for those of results.
        """
        self._folder, self._schema = folder, result_schema() if schema is None else schema
        numbers = [int(path.stem.removeprefix("part-")) for path in self._paths()]
        self._next = max(numbers, default=-1) + 1
        self._tables: list[Any] = []
        self._written = monotonic()

    def _paths(self) -> list[Path]:
        return sorted(p for p in self._folder.glob("part-*.parquet") if p.stem.removeprefix("part-").isdecimal())

    def _clear(self) -> None:
        for torn in self._folder.glob(".part-*.part"):
            torn.unlink()

    def done(self) -> dict[str, tuple[RowOutcome, ...]]:
        """What became of the tasks in the parts, by `row_id`; those of a damaged part are to be computed again.

        For who goes on with the run: what a killed one has left half written is cleared away. Of errors of the same
        class and field all have the words of the first: many rows must not cost memory.

        Warns:
            DamagedFileWarning: A part is damaged, and is put aside.
        """
        self._clear()
        found: dict[str, tuple[RowOutcome, ...]] = {}
        alike: dict[tuple[str | None, ...], RowOutcome] = {}
        shared: dict[tuple[RowOutcome, ...], tuple[RowOutcome, ...]] = {}
        with Isolated(_LATE) as child:  # whoever goes on with a long run would keep what reading takes to its end
            for path in self._paths():
                for name, one in stored(path, lambda path: child(str(path), _outcomes, path)) or ():
                    all_of_it = (*found.get(name, ()), alike.setdefault(one[:3], one))
                    found[name] = shared.setdefault(all_of_it, all_of_it)
        return found

    def worthless(self) -> bool:
        """Whether nothing would be lost with the parts: each row was refused, or is an error."""
        try:
            with Isolated(_LATE) as child:
                rows = (row for path in self._paths() for row in child(str(path), _outcomes, path))
                return all(one.status in (REFUSED, ERROR) for _, one in rows)
        except InvalidInputError:  # a damaged part may have held results
            return False

    def rows(self) -> Iterator[dict[str, Any]]:
        """The rows of all parts, as plain values."""
        for path in self._paths():
            for batch in _batches(path):
                yield from batch.to_pylist()

    def rows_in_order(self) -> list[dict[str, Any]]:
        """The rows of all parts before the first that is missing or damaged; those after it are to be computed again.

        For who goes on with the run, as `done`.

        Warns:
            DamagedFileWarning: A part is damaged, and is put aside.
        """
        self._clear()
        rows: list[dict[str, Any]] = []
        self._next = 0
        for path in self._paths():
            whole = stored(path, _rows) if path.stem == f"part-{self._next:06d}" else None
            if whole is None:
                path.unlink(missing_ok=True)  # a damaged one is aside
            else:
                rows += whole
                self._next += 1
        return rows

    def add(self, table: Any) -> None:
        """Add the rows of some tasks; they are in a part soon, all of them in the same one."""
        same = table.schema.equals(self._schema, check_metadata=True)  # a cast imports pyarrow.compute
        self._tables.append(table if same else table.cast(self._schema))
        if sum(map(len, self._tables)) >= _ROWS or monotonic() - self._written >= _SECONDS:
            self.flush()

    def flush(self) -> None:
        """Write what has been added."""
        if self._tables:
            path = self._folder / f"part-{self._next:06d}.parquet"
            with replacing(path) as part, pa.OSFile(os.fsencode(part), "wb") as sink:  # names that are no text too
                pq.write_table(pa.concat_tables(self._tables), sink, compression="zstd", write_page_checksum=True)
            self._next += 1
            self._tables = []
        self._written = monotonic()


def _outcomes(path: Path) -> list[tuple[str, RowOutcome]]:
    """Ids and outcomes of the rows of a part, all of which is read: damage may lie anywhere."""
    found: list[tuple[str, RowOutcome]] = []
    for batch in _batches(path):
        names = batch.column("row_id").to_pylist()
        known = [batch.column(name).to_pylist() for name in RowOutcome._fields if name in batch.schema.names]
        outcomes = zip(*known, strict=True) if len(known) == len(RowOutcome._fields) else [("",)] * len(names)
        found += zip(names, (RowOutcome(*one) for one in outcomes), strict=True)
    return found


def _rows(path: Path) -> list[dict[str, Any]]:
    return [row for batch in _batches(path) for row in batch.to_pylist()]


def _batches(path: Path) -> Iterator[Any]:
    """The rows of a part, some at a time."""
    try:
        with pa.OSFile(os.fsencode(path)) as file, pq.ParquetFile(file, page_checksum_verification=True) as part:
            left = part.metadata.num_rows
            for batch in part.iter_batches(_AT_ONCE):
                batch.validate(full=True)
                batch.column("row_id")
                left -= len(batch)
                yield batch
        if left:  # a column that is too short ends pyarrow's batches without a word
            raise pa.ArrowInvalid(f"{left} rows are missing")
    except (pa.ArrowException, OSError, KeyError, ValueError) as error:  # ValueError: names that are no text
        raise InvalidInputError(str(path), str(error), MADE_AGAIN) from error


def made(folder: Path) -> Path:
    """The folder, made where it does not exist.

    Raises:
        InvalidInputError: It cannot be made.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InvalidInputError("out", str(folder), f"Give a folder that can be made ({error.strerror}).") from error
    return folder


def begin(
    folder: Path,
    settings: Mapping[str, Any],
    run_format: str = FORMAT,
    *,
    anew: Callable[[], bool] = lambda: False,
) -> bool:
    """Make the folder of a run, or see that what is in it was solved with the same settings.

    Args:
        settings: What its rows depend on, as plain values.
        run_format: Name of their format.
        anew: Asked where there is a run with other settings: whether it makes place, instead of being refused.

    Returns:
        Whether one has made place.

    Raises:
        InvalidInputError: It cannot be made, or holds a run with other settings.
    """
    made(folder)
    given = parse_json(json.dumps({"format": run_format, "settings": dict(settings)}))  # as it is read again
    before = read_json(folder / RUN) if (folder / RUN).exists() else None
    parts = list(folder.glob("part-*.parquet"))
    replaced = before != given and (before is not None or bool(parts)) and anew()
    if replaced:
        for part in parts:  # before the settings: who is killed in between begins anew again
            part.unlink()
    if before is None or replaced:
        if parts and not replaced:
            raise InvalidInputError("out", str(folder), f"Give another folder: this one has parts but no {RUN}.")
        write_text(folder / RUN, json.dumps(given, indent=1) + "\n")
        return replaced
    if before != given:
        known = before.get("settings") if isinstance(before, Mapping) else None
        kept = known if isinstance(known, Mapping) else given["settings"]  # of another format, or damaged
        names = [name for name, value in given["settings"].items() if kept.get(name) != value]
        what = f"a run with other settings ({', '.join(names) or 'another format'})"
        raise InvalidInputError("out", str(folder), f"Give another folder for these: this one has {what}.")
    return False


def refuse_video(folder: Path) -> None:
    """Refuse the folder of a video's run for results of a batch: readers would mix their tables."""
    if (folder / RECORDS / RUN).exists():
        raise InvalidInputError("out", str(folder), "Give another folder: this one has a video's run.")


def refuse_batch(folder: Path) -> None:
    """Refuse the folder of a batch for a video's run."""
    if (folder / RUN).exists():
        raise InvalidInputError("out", str(folder), "Give another folder: this one has a batch's results.")


@contextmanager
def claimed(folder: Path) -> Iterator[None]:
    """The folder for one run at a time; a lock that goes with its process, where the system has such.

    Raises:
        InvalidInputError: Another run is at it.
    """
    try:
        import fcntl
    except ImportError:  # Windows: nobody is warned there
        yield
        return
    try:
        lock = (folder / "_lock").open("w")
    except OSError as error:
        fix = f"Give a folder that can be written to ({error.strerror})."
        raise InvalidInputError("out", str(folder), fix) from error
    with lock as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            raise InvalidInputError("out", str(folder), "Wait for the run that is going on there.") from error
        yield


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
        return [_named_result(row, shape.category, surfaces, ground) for row in sorted(rows, key=_row_place)]


def write_table(folder: Path, path: Path) -> Path:
    """All rows of a run's folder as one table, those that were refused included, by file and row.

    Args:
        path: `.parquet`, or `.csv`: numbers and texts alone, with the corners of the 2D box.
    """
    rows = sorted(Parts(folder).rows(), key=_row_place)
    if path.suffix.lower() == ".parquet":
        pq.write_table(table_of(rows), sink := io.BytesIO(), compression="zstd")
        return write_bytes(path, sink.getvalue())
    names = [entry.name for entry in result_schema() if not pa.types.is_list(entry.type)]
    return export_rows(path, [{name: row.get(name) for name in names} | _corners(row["box"]) for row in rows])


def _corners(box: Sequence[float] | None) -> dict[str, float | None]:
    return dict(zip(("x1", "y1", "x2", "y2"), box or (None,) * 4, strict=True))


def _row_place(row: Mapping[str, Any]) -> tuple[str, int, int]:
    """Where a row comes among the others, whenever it was solved: by its file, its number there, and its vehicle."""
    number = row["row_id"].removeprefix(row["source"]).removeprefix("#")
    return row["source"], int(number) if number.isdecimal() else 0, row["vehicle"] or 0


def _named_result(row: Mapping[str, Any], category: Category, surfaces: Surfaces, ground: Ground | None) -> NamedResult:
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
