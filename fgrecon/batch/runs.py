"""A run: files in, Parquet parts out, by a pool of processes or by Ray; killed, it goes on where it was.

Fingerprints say what a run's files were when their rows were reconstructed: an edited file does not count as done. Of
images and videos they are size and time of change, since they are many or large; of keypoint files their content, so
that one to which rows were added at its end goes on.
"""

from __future__ import annotations

import hashlib
import json
from array import array
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pyarrow.compute as pc

from fgrecon.batch.inputs import InputFile
from fgrecon.batch.parts import Parts, RowOutcome, begin, claimed, made, refuse_video
from fgrecon.batch.pool import work, work_on_ray
from fgrecon.batch.reconstructor import Reconstructor
from fgrecon.batch.rows import lost_rows, single_tasks, storable
from fgrecon.batch.schema import Tasks, TaskSolver
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.input_warnings import InputWarning, InputWarnings
from fgrecon.core.serialise import well_formed
from fgrecon.core.text import whole_text
from fgrecon.io.files import MADE_AGAIN, stored, write_text
from fgrecon.io.json_fields import read_json

_VEHICLES, _PICTURES = 32, 8
"""Rows that a worker gets at once: about a second's work."""


@dataclass
class Tally:
    """How far a run has come.

    Attributes:
        total: Rows of all inputs.
        before: Of these, done by runs before this one.
        done: Of these, done by now.
        anew: Whether a run with other settings, of which nothing was reconstructed, made place for this one.
        statuses: Rows of results by status, those that were done before included; an image gives one for each vehicle.
        errors: Those with an error, by its class and the field that it names.
        words: Of each of these errors what the first row says, which has the fix.
        input_warnings: Warnings of the keypoints of this run's rows.
        left_out: Vehicles and images of which something was not used, of this run's rows, with what.
        box_excesses: By how much 2D boxes are larger than their vehicles look, of this run's rows that tell.
    """

    total: int
    before: int = 0
    done: int = 0
    anew: bool = False
    statuses: Counter[str] = field(default_factory=Counter)
    errors: Counter[str] = field(default_factory=Counter)
    words: dict[str, str] = field(default_factory=dict)
    input_warnings: InputWarnings = field(default_factory=InputWarnings)
    left_out: list[str] = field(default_factory=list)
    box_excesses: array[float] = field(default_factory=lambda: array("d"))

    def add(self, table: Any) -> None:
        """Count a table of results."""
        self.done += len(pc.unique(table.column("row_id")))
        self._count(
            map(RowOutcome._make, zip(*(table.column(name).to_pylist() for name in RowOutcome._fields), strict=True))
        )
        self.input_warnings.judged += pc.count(table.column("camera_T_object")).as_py()
        for name, warning in zip(*(table.column(name).to_pylist() for name in ("id", "input_warning")), strict=True):
            if warning is not None:
                self.input_warnings.add(name or "", InputWarning(warning))
        columns = (table.column(name).to_pylist() for name in ("id", "row_id", "left_out", "own_shares"))
        for name, row, left_out, own_shares in zip(*columns, strict=True):
            self.left_out += [f"{name or row}: {left_out[0]}"] if left_out else []
            self.input_warnings.add_scanned(name or row, own_shares or {})
        self.box_excesses.extend(pc.drop_null(table.column("box_excess")).to_pylist())

    def add_stored(self, outcomes: Iterable[RowOutcome]) -> None:
        """Count the rows of results of a task that was done by a run before this one."""
        self.before += 1
        self.done += 1
        self._count(outcomes)

    def _count(self, outcomes: Iterable[RowOutcome]) -> None:
        for status, kind, place, words in outcomes:
            self.statuses[status] += 1
            if kind is not None:
                name = kind if place is None else f"{kind}: {place}"
                self.errors[name] += 1
                self.words.setdefault(name, words or "")


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
    row becomes its status; a row during which its worker dies is tried again, and given up the fourth time. A run with
    other settings makes place where each of its rows was refused or is an error.

    Args:
        sources: The files (`sources_of`).
        out: The folder, made where it does not exist.
        reconstructor: What does the work.
        jobs: Processes here, or actors at most on Ray.
        ray: Address of a Ray cluster, or `auto`; None for processes of this machine.
        batch_rows: Rows that a worker gets at once.
        settings: What the reconstructor was made with, as plain values; a folder is for one such.
        report: Called whenever rows are done.

    Raises:
        InvalidInputError: The folder holds another run or a video's, a file of which it has rows was edited since, or
            the prior cannot be loaded.
        MissingPackageError: Ray is not installed.
        WorkerDiedError: Workers cannot even begin.

    Warns:
        DamagedFileWarning: A part, or what the files were, is damaged, and is put aside.
    """
    if jobs < 1:
        raise InvalidInputError("jobs", jobs, "Give at least one.")
    reconstructor.prior  # noqa: B018 - a prior that cannot be loaded is reported before the workers start
    folder = Path(out)
    refuse_video(folder)
    with claimed(made(folder)):  # first: another run may be at rows that are worth something
        anew = begin(folder, settings or {}, anew=lambda: Parts(folder).worthless())
        parts = Parts(folder)
        done = parts.done()
        check_unedited(folder, sources, done)
        tally = Tally(sum(source.count() for source in sources), anew=anew)
        batches = _batches(_left(sources, done, tally), batch_rows)
        report(tally)
        if ray is None:
            tables = work(TaskSolver(reconstructor), batches, jobs, single_tasks, lost_rows)
        else:
            tables = work_on_ray(TaskSolver(reconstructor), batches, jobs, single_tasks, lost_rows, ray)
        try:
            for table in tables:
                parts.add(table)
                tally.add(table)
                report(tally)
        finally:
            parts.flush()
    return tally


def _left(
    sources: Sequence[InputFile], done: Mapping[str, Sequence[RowOutcome]], tally: Tally
) -> Iterator[tuple[bool, dict[str, Any]]]:
    """The rows that are not done yet, and whether each is an image."""
    for source in sources:
        for row in map(storable, source.rows()):
            if (outcomes := done.get(row["row_id"])) is not None:
                tally.add_stored(outcomes)
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


INPUTS = "_inputs.json"
"""The fingerprints of a run's files; beside the parts."""

_BLOCK_BYTES = 1 << 20


def check_unedited(folder: Path, sources: Sequence[InputFile], done: Collection[str]) -> None:
    """Refuse a file of which rows are done and that is another one now; remember the fingerprints of the others."""
    path = folder / INPUTS
    known = stored(path, _known) or {}
    begun = {name.rpartition("#")[0] for name in done}.union(done)
    for source in sources:
        name = whole_text(str(source.path))
        before = known.get(name)
        try:
            now = _fingerprint(source)
            edited = before is not None and name in begun and not _goes_on(before, now, source.path)
        except OSError:  # a row will say so
            continue
        if before is not None and edited:
            when = "before it was edited" if before["place"] == now["place"] else f"of {before['place']}"
            fix = f"Give another folder for its results: this one has rows of that name, reconstructed {when}."
            raise InvalidInputError("input", name, fix)
        known[name] = now
    write_text(path, json.dumps(known, indent=0) + "\n")


def _known(path: Path) -> dict[str, dict[str, Any]]:
    """The fingerprints of a file, which may be damaged."""
    content = read_json(path)
    with well_formed(str(path), MADE_AGAIN):
        return {name: {"place": str(one["place"]), "bytes": int(one["bytes"]), **one} for name, one in content.items()}


def _fingerprint(source: InputFile) -> dict[str, Any]:
    state = source.path.stat()
    common = {"place": whole_text(str(source.path.resolve())), "bytes": state.st_size}
    if source.is_picture:
        return {**common, "modified_ns": state.st_mtime_ns}
    return {**common, "sha256": _hash(source.path, state.st_size)}


def _goes_on(before: dict[str, Any], now: dict[str, Any], path: Path) -> bool:
    """Whether the rows that a file had are there still."""
    if before == now:
        return True
    if "sha256" not in now or before["place"] != now["place"] or before["bytes"] > now["bytes"]:
        return False
    return _hash(path, before["bytes"]) == before.get("sha256")


def _hash(path: Path, size: int) -> str:
    """SHA-256 of a file's first bytes."""
    digest, left = hashlib.sha256(), size
    with path.open("rb") as file:
        while left > 0 and (block := file.read(min(_BLOCK_BYTES, left))):
            digest.update(block)
            left -= len(block)
    return digest.hexdigest()
