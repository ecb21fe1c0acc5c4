"""A run: files in, Parquet parts out, by a pool of processes or by Ray; killed, it goes on where it was."""

from __future__ import annotations

from array import array
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pyarrow.compute as pc

from fgrecon.batch.inputs import InputFile
from fgrecon.batch.parts import Parts, begin, claimed, refuse_video
from fgrecon.batch.pool import work
from fgrecon.batch.reconstructor import Reconstructor
from fgrecon.batch.rows import lost_rows, single_tasks, storable
from fgrecon.batch.tasks import Tasks, TaskSolver
from fgrecon.core.errors import InvalidInputError

__all__ = ["Tally", "run"]

_VEHICLES, _PICTURES = 32, 8
"""Rows that a worker gets at once: about a second's work."""


@dataclass
class Tally:
    """How far a run has come.

    Attributes:
        total: Rows of all inputs.
        before: Of these, done by runs before this one.
        done: Of these, done by now.
        statuses: Rows of results of this run, by status; an image gives one for each vehicle.
        errors: Those with an error, by its class and the field that it names.
        words: Of each of these errors what the first row says, which has the fix.
        box_excesses: By how much 2D boxes are larger than their vehicles look, of this run's rows that tell.
    """

    total: int
    before: int = 0
    done: int = 0
    statuses: Counter[str] = field(default_factory=Counter)
    errors: Counter[str] = field(default_factory=Counter)
    words: dict[str, str] = field(default_factory=dict)
    box_excesses: array[float] = field(default_factory=lambda: array("d"))

    def add(self, table: Any) -> None:
        """Count a table of results."""
        self.done += len(pc.unique(table.column("row_id")))
        self.statuses.update(table.column("status").to_pylist())
        columns = (table.column(name).to_pylist() for name in ("error_type", "error_field", "error"))
        for kind, place, words in zip(*columns, strict=True):
            if kind is not None:
                name = kind if place is None else f"{kind}: {place}"
                self.errors[name] += 1
                self.words.setdefault(name, words)
        self.box_excesses.extend(pc.drop_null(table.column("box_excess")).to_pylist())


def run(
    sources: Sequence[InputFile],
    out: str | Path,
    reconstructor: Reconstructor,
    *,
    jobs: int = 1,
    ray: str | None = None,
    batch_rows: int | None = None,
    settings: Mapping[str, Any] | None = None,
    report: Callable[[Tally], None] = lambda _: None,
) -> Tally:
    """Reconstruct every row of some files into a folder of Parquet parts.

    Rows that are in the folder already are not done again, so a run that was killed goes on. Whatever is wrong with a
    row becomes its status; a row during which its worker dies is tried again, and given up the fourth time.

    Args:
        sources: The files (`sources_of`).
        out: The folder, made where it does not exist.
        reconstructor: What does the work.
        jobs: Processes here, or actors at most on Ray.
        ray: Address of a Ray cluster, or `auto`; None for processes of this machine.
        batch_rows: Rows that a worker gets at once.
        settings: What the reconstructor was made with, as plain values; a folder is for one such.
        report: Called whenever rows are done.

    Returns:
        What was done.

    Raises:
        InvalidInputError: The folder holds another run or a video's, or the prior cannot be loaded.
        MissingPackageError: Ray is not installed.
        WorkerDiedError: Workers cannot even begin.
    """
    if jobs < 1:
        raise InvalidInputError("jobs", jobs, "Give at least one.")
    reconstructor.prior  # noqa: B018 - a prior that cannot be loaded is told before the workers start
    folder = Path(out)
    refuse_video(folder)
    begin(folder, settings or {})
    with claimed(folder):
        parts = Parts(folder)
        done = parts.done()
        tally = Tally(sum(source.count() for source in sources))
        batches = _batches(_left(sources, done, tally), batch_rows)
        report(tally)
        if ray is None:
            tables = work(TaskSolver(reconstructor), batches, jobs, single_tasks, lost_rows)
        else:
            from fgrecon.batch.on_ray import work_on_ray

            tables = work_on_ray(TaskSolver(reconstructor), batches, jobs, ray)
        try:
            for table in tables:
                parts.add(table)
                tally.add(table)
                report(tally)
        finally:
            parts.flush()
    return tally


def _left(sources: Sequence[InputFile], done: set[str], tally: Tally) -> Iterator[tuple[bool, dict[str, Any]]]:
    """The rows that are not done yet, and whether each is an image."""
    for source in sources:
        for row in map(storable, source.rows()):
            if row["row_id"] in done:
                tally.before += 1
                tally.done += 1
            else:
                yield source.is_picture, row


def _batches(rows: Iterable[tuple[bool, dict[str, Any]]], size: int | None) -> Iterator[Tasks]:
    """Rows that a worker gets at once, images apart from others."""
    waiting: list[dict[str, Any]] = []
    of_pictures = False
    for is_picture, row in rows:
        full = len(waiting) >= (size or (_PICTURES if of_pictures else _VEHICLES))
        if waiting and (full or is_picture != of_pictures):
            yield waiting
            waiting = []
        waiting.append(row)
        of_pictures = is_picture
    if waiting:
        yield waiting
