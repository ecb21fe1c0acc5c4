"""Live input: the newest frame is next, and those that it overtakes are skipped, so that no delay builds up.

camera ---- thread: takes what comes ---- newest ---- who works on it, as long as it takes
                                      +-- those before it, which are left out
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Collection, Generator, Iterable, Iterator
from contextlib import closing
from contextvars import copy_context
from dataclasses import dataclass, replace
from threading import Condition, Thread
from typing import Generic, TypeVar

from fgrecon.core.checks import as_finite
from fgrecon.core.errors import InvalidInputError
from fgrecon.io.source_frames import SourceFrame

T = TypeVar("T")


@dataclass(frozen=True)
class NewestSettings:
    """How long work on an item is expected to take.

    Attributes:
        remembered_share: Of what was expected before, where the last item took less: not tuned.
        delays: That are kept, of the last items.
        close_s: For which the thread is waited for at the end, which may itself wait for an item.
    """

    remembered_share: float = 0.9
    delays: int = 10_000
    close_s: float = 1.0


SETTINGS = NewestSettings()


class Newest(Generic[T]):
    """Items as they come, such as a camera's images; iterate over it, and each is the newest there is.

    Attributes:
        left_out: How many were not taken.
        delays: Seconds from the coming of an item to the end of the work on it, of the last ones that were taken.
    """

    def __init__(
        self, items: Iterable[T], *, max_delay: float | None = None, leave_out: Callable[[T], T] | None = None
    ) -> None:
        """Take where they come from.

        Args:
            items: Iterating over it waits for the next one, in a thread; it ends with the items.
            max_delay: Seconds from an item's coming to the end of the work on it. One that would take longer, by how
                long others took, is left out, unless it has come just now. None takes the newest, however old.
            leave_out: Makes of an item that is left out what stands in its place; None: nothing does.

        Raises:
            InvalidInputError: The delay is not positive.
        """
        self._items, self._most, self._leave_out = items, as_max_delay(max_delay), leave_out
        self._there: tuple[float, T] | None = None
        self._before: list[T] = []  # what stands for those that it has overtaken
        self._change, self._ended = Condition(), False
        self._error: BaseException | None = None
        self._work = 0.0
        self.left_out = 0
        self.delays: deque[float] = deque(maxlen=SETTINGS.delays)

    def __iter__(self) -> Generator[T]:
        """Those that are taken; whatever is raised where they come from is raised here."""
        worker = Thread(target=copy_context().run, args=(self._take,), name="fgrecon newest", daemon=True)
        worker.start()
        try:
            while there := self._wait():
                fresh, came, item = there
                begun = time.monotonic()
                taken = fresh or self._most is None or begun - came + self._work <= self._most
                with self._change:
                    if not taken:
                        self._leave(item)
                    before, self._before = self._before, []
                yield from before
                if taken:
                    yield item
                    self._note(came, begun)
            if self._error is not None:
                raise self._error
        finally:
            with self._change:
                self._ended = True
            worker.join(SETTINGS.close_s)

    def _note(self, came: float, begun: float) -> None:
        """Remember how long an item took."""
        now, kept = time.monotonic(), SETTINGS.remembered_share
        self.delays.append(now - came)
        self._work = max(now - begun, kept * self._work + (1.0 - kept) * (now - begun))

    def _wait(self) -> tuple[bool, float, T] | None:
        """Whether it had to be waited for, when it came, and the newest item; None at the end."""
        with self._change:
            fresh = self._there is None
            self._change.wait_for(lambda: self._there or self._ended)
            there, self._there = self._there, None
        return None if there is None else (fresh, *there)

    def _leave(self, item: T) -> None:
        self.left_out += 1
        if self._leave_out is not None:
            self._before.append(self._leave_out(item))

    def _take(self) -> None:
        """Take what comes until there is no more, or nobody wants it."""
        error: BaseException | None = None
        items = iter(self._items)
        try:
            for item in items:
                with self._change:
                    if self._ended:
                        return
                    if self._there is not None:
                        self._leave(self._there[1])
                    self._there = time.monotonic(), item
                    self._change.notify()
        except BaseException as raised:  # noqa: BLE001 - whoever takes the items raises it
            error = raised
        finally:
            if (close := getattr(items, "close", None)) is not None:
                close()
            with self._change:
                self._error, self._ended = error, True
                self._change.notify()


def as_max_delay(max_delay: float | None) -> float | None:
    """The same, checked.

    Raises:
        InvalidInputError: It is not positive.
    """
    if max_delay is None:
        return None
    seconds = float(as_finite("max_delay", max_delay, (), "Give seconds."))
    if not seconds > 0.0:
        raise InvalidInputError("max_delay", max_delay, "Give seconds, more than 0.")
    return seconds


LEFT_OUT = "left out, since a newer one had come or was due"
"""What the problem of a frame ends with that was left out."""


def is_left_out(problem: str | None) -> bool:
    """Whether that is the problem of a frame, as records keep it."""
    return problem is not None and problem.endswith(LEFT_OUT)


class LiveFrames:
    """Frames of a file as if a camera took them: each comes when it is due by its time, and the newest is taken.

    Attributes:
        max_delay: That of `Newest`.
        delays: Those of `Newest`; of the first frame there is none.
    """

    def __init__(self, max_delay: float) -> None:
        """Begin without frames."""
        self.max_delay = as_max_delay(max_delay)
        self.delays: Collection[float] = ()

    def __call__(self, frames: Generator[SourceFrame], after: int | None = None) -> Generator[SourceFrame]:
        """All of them in order, those that are left out as gaps.

        The clock begins when the first one is done, with which things are loaded.

        Args:
            after: Those up to this number come at once; None where all are live.
        """
        for first in frames:
            yield first
            if after is None or first.number > after:
                break
        else:
            return
        newest = Newest(_when_due(frames, first.time), max_delay=self.max_delay, leave_out=_left_out)
        self.delays = newest.delays
        yield from newest


def _when_due(frames: Generator[SourceFrame], begin: float) -> Iterator[SourceFrame]:
    """Each frame when it is due, where the clock begins now at some seconds of the frames' own."""
    began = time.monotonic() - begin
    with closing(frames):
        for frame in frames:
            time.sleep(max(0.0, began + frame.time - time.monotonic()))
            yield frame


def _left_out(frame: SourceFrame) -> SourceFrame:
    return replace(frame, image=None, problem=f"{frame.name}: {LEFT_OUT}", left_out=True)
