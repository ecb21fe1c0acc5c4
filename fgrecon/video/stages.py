"""Pipeline of a run: each stage in a thread of its own, and no more than some frames ahead of the next.

    frames -- queue -- boxes -- queue -- keypoints -- queue -- the camera's motion -- queue -- who takes them (solves)

Reading, OpenCV and the networks' runtimes let other threads of Python run meanwhile. Every stage takes frames in
order, so that results are those of one stage after the other.
"""

from __future__ import annotations

import gc
import sys
from collections.abc import Generator, Iterator
from contextlib import contextmanager
from contextvars import copy_context
from dataclasses import dataclass
from queue import Empty, Queue
from threading import Event, Thread
from typing import Generic, TypeVar

T = TypeVar("T")


@dataclass(frozen=True)
class StageSettings:
    """How stages share the interpreter.

    Attributes:
        turn_s: After which a thread that computes in Python lets another one go on, which waits for every result of
            OpenCV and of a network's runtime: Python's own 5 ms let these stages wait for most of the time. Chosen on
            drive 0095 of KITTI.
        look_again_s: After which a stage that is to end is looked at again.
        collect_every: By how much less often Python's collector of cycles runs: all stages wait for it.
    """

    turn_s: float = 0.0005
    look_again_s: float = 0.02
    collect_every: int = 10


SETTINGS = StageSettings()


@dataclass(frozen=True)
class _Item(Generic[T]):
    value: T


@dataclass(frozen=True)
class _End:
    """Of the items: there are no more, or an error."""

    error: BaseException | None = None


def made_ahead(items: Iterator[T], most: int, name: str) -> Generator[T]:
    """The same items in the same order, made by a thread while others are worked on.

    Whatever is raised where they are made is raised here in its place. Closing it ends the thread, and closes `items`
    where that is a generator.

    Args:
        most: So many at most are ahead of who takes them; 0 makes them without a thread.
    """
    if not most:
        yield from items
        return
    ready: Queue[_Item[T] | _End] = Queue(most)
    ended = Event()
    worker = Thread(target=copy_context().run, args=(_make, items, ready, ended), name=f"fgrecon {name}", daemon=True)
    worker.start()
    try:
        while isinstance(found := ready.get(), _Item):
            yield found.value
        if found.error is not None:
            raise found.error
    finally:
        ended.set()
        while worker.is_alive():  # it may wait for room
            try:
                ready.get(timeout=SETTINGS.look_again_s)
            except Empty:
                continue
        worker.join()


def _make(items: Iterator[T], ready: Queue[_Item[T] | _End], ended: Event) -> None:
    error: BaseException | None = None
    try:
        for item in items:
            if ended.is_set():
                return
            ready.put(_Item(item))
            if ended.is_set():
                return
    except BaseException as raised:  # noqa: BLE001 - whoever takes the items raises it
        error = raised
    finally:
        if (close := getattr(items, "close", None)) is not None:
            close()
        if not ended.is_set():
            ready.put(_End(error))


@contextmanager
def short_turns(most: int) -> Iterator[None]:
    """Let threads of Python take turns often while stages are side by side; 0 frames ahead change nothing."""
    before = sys.getswitchinterval()
    sys.setswitchinterval(min(before, SETTINGS.turn_s) if most else before)
    try:
        yield
    finally:
        sys.setswitchinterval(before)


@contextmanager
def rare_collections() -> Iterator[None]:
    """Let Python's collector of cycles run less often, and not look at what there is already.

    What others have frozen stays so, and then what there is is looked at.
    """
    before, frozen = gc.get_threshold(), gc.get_freeze_count()
    if not frozen:
        gc.freeze()
    gc.set_threshold(before[0] * SETTINGS.collect_every, *before[1:])
    try:
        yield
    finally:
        gc.set_threshold(*before)
        if not frozen:
            gc.unfreeze()
