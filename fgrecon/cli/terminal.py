"""The terminal: verbosity, streams, progress, and the list of written files."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from functools import cached_property
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Protocol, TypeVar

from fgrecon.cli.commands import option
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.text import printable, whole_text

if TYPE_CHECKING:  # the command line must start fast: what the commands need is imported when they run
    from rich.console import Console, RenderableType
    from rich.progress import Task, TaskID
    from rich.table import Table
    from rich.text import Text

_WIDTH = 180

Thing = TypeVar("Thing")


class Screen:
    """What a command says.

    Attributes:
        quiet: Whether nothing but errors is said: what takes time to make for the terminal need not be made.
        verbose: Whether the user wants to know more.
    """

    def __init__(
        self,
        json_out: str | None = None,
        *,
        error: bool,
        quiet: bool,
        verbose: bool = False,
        progress: bool | None = False,
    ) -> None:
        """Choose the streams: where the output carries data, all words go to the error stream.

        Args:
            json_out: What `--json` names.
            error: Whether the output carries other data.
            quiet: Say nothing but errors.
            verbose: Say more.
            progress: Whether progress is shown; None shows it on a terminal.
        """
        self.quiet, self.verbose = quiet, verbose and not quiet
        self._json, self._error, self._progress = json_out, error or json_out == "-", progress

    @cached_property
    def console(self) -> Console:
        """Where tables go."""
        return _console(error=self._error, quiet=self.quiet)

    @cached_property
    def errors(self) -> Console:
        """The error stream, for what is not part of the result."""
        return _console(error=True, quiet=self.quiet)

    @property
    def bars(self) -> bool:
        """Whether progress is shown."""
        return not self.quiet and (self.errors.is_terminal if self._progress is None else self._progress)

    def print(self, *things: RenderableType) -> None:
        """Print tables, or lines as they are."""
        for thing in things:
            self.console.print(printable(thing) if isinstance(thing, str) else thing, markup=False)

    def detail(self, *things: RenderableType) -> None:
        """Print what only --verbose shows."""
        if self.verbose:
            self.print(*things)

    def note(self, line: str) -> None:
        """Print a line about the work to the error stream."""
        self.errors.print(printable(line), markup=False)

    def warn(self, line: str) -> None:
        """Print a warning to the error stream."""
        self.note(f"Warning: {line}")

    def fail(self, line: str) -> None:
        """Print why the work failed, even with --quiet."""
        print(f"fgrecon: {printable(line)}", file=sys.stderr)  # noqa: T201

    def wrote(self, *paths: str | Path) -> None:
        """Say which files were written."""
        for path in paths:
            self.print(f"Wrote {path}.")

    def write_text(self, path: Path | None, text: str) -> None:
        """Write a file, whole or not at all, and say so; nothing without a path."""
        from fgrecon.io.files import write_text

        if path is not None:
            self.wrote(write_text(path, text))

    def write_output(self, option: str, text: str) -> None:
        """Write a text to the output, for want of a file that an option gives."""
        if sys.stdout is None:
            raise InvalidInputError(option, "no file, and a closed output", "Give a file.")
        sys.stdout.write(text)

    def write_json(self, text: str) -> None:
        """Write the text of --json to its file, or for `-` to the output; nothing where it is not given."""
        if self._json == "-":
            self.write_output("json", _json_for(getattr(sys.stdout, "encoding", "utf-8"), whole_text(text)))
        elif self._json is not None:
            self.write_text(Path(self._json), text)

    def write_document(self, content: Any) -> None:
        """Write plain values as `write_json` writes a text."""
        if self._json is not None:
            self.write_json(json.dumps(content, indent=1, allow_nan=False) + "\n")

    def watch(self, things: Sequence[Thing], heading: str) -> Iterator[Thing]:
        """Go through some things and show how far that has come; a single thing is not worth a bar."""
        with progress_bar(self.errors, shown=self.bars and len(things) > 1) as advance:
            yield from stepwise(things, heading, advance)

    def bar(self, *, per_minute: bool = False) -> AbstractContextManager[Advance]:
        """Bars for work that says how far it has come; see `progress_bar`."""
        return progress_bar(self.errors, shown=self.bars, per_minute=per_minute)


@dataclass(frozen=True)
class Quiet:
    """How much a short command says."""

    panel: ClassVar = "Terminal"

    quiet: bool = option("Say nothing but errors.", "--quiet", "-q", default=False)

    def screen(self, json_out: str | None = None, *, error: bool = False) -> Screen:
        """Where the command says it; see `Screen`."""
        return Screen(json_out, error=error, **vars(self))


@dataclass(frozen=True)
class Verbosity(Quiet):
    """How much a command says that can say more."""

    verbose: bool = option("Say more.", "--verbose", "-v", default=False)


@dataclass(frozen=True)
class Terminal(Verbosity):
    """How much a command says whose work may take long."""

    progress: bool | None = option("Show progress.", "--progress/--no-progress", show_default="on a terminal")


def _json_for(encoding: str | None, text: str) -> str:
    """JSON of the same content that an output of this encoding can take."""
    try:
        text.encode(encoding or "utf-8")
    except UnicodeEncodeError:  # outside of its texts JSON is ASCII
        return "".join(c if c.isascii() else json.dumps(c)[1:-1] for c in text)
    return text


def _console(*, error: bool, quiet: bool) -> Console:
    from rich.console import Console

    made = Console(stderr=error, highlight=False, soft_wrap=True, quiet=quiet)
    if not made.is_terminal:
        made.width = _WIDTH  # a pipe has no width, and 80 columns would cut the numbers off
    return made


class Advance(Protocol):
    """Shows how far a step has come."""

    def __call__(self, step: str, done: float, total: float | None, note: str = "") -> None:
        """Show it.

        Args:
            step: What is being done; every step has a line of its own.
            done: How much of it.
            total: How much there is; None where nobody knows.
            note: What else there is to say about it.
        """


@contextmanager
def progress_bar(console: Console, *, shown: bool, per_minute: bool = False) -> Iterator[Advance]:
    """A line for every step that is given, gone at the end; nothing where it is not shown.

    Args:
        console: Where it is shown.
        shown: Whether it is.
        per_minute: Rates by the minute, for work of which one piece takes long.
    """
    if not shown:
        yield lambda step, done, total, note="": None  # noqa: ARG005 - called by these names
        return
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, ProgressColumn, TextColumn, TimeRemainingColumn
    from rich.text import Text as RichText

    class Rate(ProgressColumn):
        def render(self, task: Task) -> Text:
            speed, unit = task.finished_speed or task.speed, "min" if per_minute else "s"
            words = f"{(60 if per_minute else 1) * speed:.1f}/{unit}" if speed else ""
            return RichText(words, style="progress.data.speed")

    columns = (
        *(TextColumn("{task.description}", markup=False), BarColumn(), MofNCompleteColumn(), Rate()),
        *(TimeRemainingColumn(), TextColumn("{task.fields[note]}", markup=False)),
    )
    tasks: dict[str, TaskID] = {}
    with Progress(*columns, console=console, transient=True) as bar:

        def advance(step: str, done: float, total: float | None, note: str = "") -> None:
            if step not in tasks:
                tasks[step] = bar.add_task(step, total=total, completed=int(done), note=note)
            bar.update(tasks[step], completed=done, total=total, note=note)

        yield advance


def stepwise(things: Sequence[Thing], heading: str, advance: Advance) -> Iterator[Thing]:
    """Go through some things and say how far that has come."""
    for done, thing in enumerate(things):
        advance(heading, done, len(things))
        yield thing
    advance(heading, len(things), len(things))


def counting(advance: Advance, step: str, total: int) -> Callable[[str], None]:
    """Turns word of one more piece, with its name, into how many of all are done."""
    done = count(1)
    return lambda name: advance(step, next(done), total, name)


def headed_table(*headings: str, left: int = 1, title: str | None = None) -> Table:
    """A table without rows, of texts in its first columns and of numbers in the others.

    Args:
        headings: Of the columns.
        left: How many hold texts, which are never wrapped; where the terminal is narrow numbers are, and never cut.
        title: Above it.
    """
    from rich.box import SIMPLE_HEAD
    from rich.table import Table

    table = Table(box=SIMPLE_HEAD, pad_edge=False, title=title)
    for number, heading in enumerate(headings):
        is_text = number < left
        table.add_column(heading, justify="left" if is_text else "right", no_wrap=is_text, overflow="fold")
    return table


def compact_table(*headings: str, text: Sequence[str] = ("status",), **column: Any) -> Table:
    """A table without rows and margins; all columns but those of texts are of numbers, on the right.

    Args:
        headings: Of the columns.
        text: Those of columns that hold texts.
        column: What else holds for all columns, as rich takes it.
    """
    from rich.box import SIMPLE_HEAD
    from rich.table import Table

    table = Table(box=SIMPLE_HEAD, show_edge=False, pad_edge=False, collapse_padding=True)
    for heading in headings:
        table.add_column(heading, justify="left" if heading in text else "right", **column)
    return table
