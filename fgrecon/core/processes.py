"""Set-up of process pools."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from functools import partial
from typing import Any, TypeVar

Task = TypeVar("Task")
Result = TypeVar("Result")

_kept: Callable[[Any], Any]


@contextmanager
def one_thread_each() -> Iterator[None]:
    """Processes started inside use one thread each: the parallelism is between them."""
    names = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS")
    before = {name: os.environ.get(name) for name in names}
    os.environ.update(dict.fromkeys(names, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


@contextmanager
def processes(count: int, start: Callable[[], object] = int) -> Iterator[ProcessPoolExecutor]:
    """Processes of one thread each; where the body raises, as by Ctrl-C, tasks that wait are left out.

    Args:
        count: How many.
        start: Called in each of them first.
    """
    with one_thread_each(), ProcessPoolExecutor(count, multiprocessing.get_context("spawn"), _begin, (start,)) as pool:
        with no_interrupts():
            for _ in range(count):  # each starts a process, as none is idle so soon
                pool.submit(int)
        try:
            yield pool
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise


@contextmanager
def processes_with(
    make: Callable[[], Callable[[Task], Result]], count: int
) -> Iterator[tuple[ProcessPoolExecutor, Callable[[Task], Result]]]:
    """`processes` that keep what they work with.

    Args:
        make: Makes it, once in each process, to which it is sent once.
        count: How many processes.

    Yields:
        The pool, and the function to give to it with each task: what `make` made there is called with the task.
    """
    with processes(count, partial(_keep_made, make)) as pool:
        yield pool, run_kept


@contextmanager
def no_interrupts() -> Iterator[None]:
    """Processes started inside do not notice Ctrl-C, which a terminal sends to them too, before they ignore it."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def obey_parent() -> None:
    """Leave Ctrl-C to the parent, which ends its workers; one that is killed can end none, so they look."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, [signal.SIGINT])
    threading.Thread(target=_follow_parent, daemon=True).start()


def _begin(start: Callable[[], object]) -> None:
    start()
    obey_parent()


def _keep_made(make: Callable[[], Callable[[Any], Any]]) -> None:
    keep(make())


def _follow_parent() -> None:
    parent = multiprocessing.parent_process()
    assert parent is not None
    parent.join()
    os._exit(1)


def keep(function: Callable[[Any], Any]) -> None:
    """Let `run_kept` call a function in this process from now on."""
    global _kept  # noqa: PLW0603 - a pool has no other place for what its processes keep
    _kept = function


def run_kept(task: Any) -> Any:
    """What the function that this process keeps makes of a task."""
    return _kept(task)
