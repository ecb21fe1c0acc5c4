"""Progress of long work on the error stream: how much is done, of how much, how fast, and how long it still takes."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from itertools import count
from typing import TYPE_CHECKING, Protocol, TypeVar

if TYPE_CHECKING:  # the command line must start fast: rich is imported when a bar is shown
    from rich.console import Console
    from rich.progress import Task
    from rich.text import Text

__all__ = ["Advance", "counted", "counting", "progress_bar", "watched"]

Thing = TypeVar("Thing")


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
    """A line for every step that is told, gone at the end; nothing where it is not shown.

    Args:
        console: Where it is shown.
        shown: Whether it is.
        per_minute: Rates by the minute, for work of which one piece takes long.
    """
    if not shown:
        yield lambda step, done, total, note="": None  # noqa: ARG005 - called by these names
        return
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, ProgressColumn, TextColumn, TimeRemainingColumn
    from rich.progress import Task as RichTask
    from rich.text import Text as RichText

    class Rate(ProgressColumn):
        def render(self, task: Task) -> Text:
            return RichText(_rate(task), style="progress.data.speed")

    columns = (
        *(TextColumn("{task.description}", markup=False), BarColumn(), MofNCompleteColumn(), Rate()),
        *(TimeRemainingColumn(), TextColumn("{task.fields[note]}", markup=False)),
    )
    tasks: dict[str, RichTask] = {}

    def _rate(task: Task) -> str:
        speed = task.finished_speed or task.speed
        if not speed:
            return ""
        return f"{60 * speed:.1f}/min" if per_minute else f"{speed:.1f}/s"

    with Progress(*columns, console=console, transient=True) as bar:

        def advance(step: str, done: float, total: float | None, note: str = "") -> None:
            if step not in tasks:
                identity = bar.add_task(step, total=total, completed=int(done), note=note)
                tasks[step] = bar.tasks[bar.task_ids.index(identity)]
            bar.update(tasks[step].id, completed=done, total=total, note=note)

        yield advance


def watched(things: Sequence[Thing], heading: str, console: Console, *, shown: bool) -> Iterable[Thing]:
    """Go through some things and show how far that has come.

    Args:
        things: What to go through.
        heading: What is being done to them.
        console: Where it is shown.
        shown: Whether it is; a single thing is not worth a bar.
    """
    with progress_bar(console, shown=shown and len(things) > 1) as advance:
        yield from counted(things, heading, advance)


def counted(things: Sequence[Thing], heading: str, advance: Advance) -> Iterator[Thing]:
    """Go through some things and tell how far that has come."""
    for done, thing in enumerate(things):
        advance(heading, done, len(things))
        yield thing
    advance(heading, len(things), len(things))


def counting(advance: Advance, step: str, total: int) -> Callable[[str], None]:
    """Turns word of one more piece, with its name, into how many of all are done."""
    done = count(1)
    return lambda name: advance(step, next(done), total, name)
