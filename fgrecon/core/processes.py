"""Set-up of process pools."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing import get_context
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
def processes_with(
    make: Callable[[], Callable[[Task], Result]], count: int
) -> Iterator[tuple[ProcessPoolExecutor, Callable[[Task], Result]]]:
    """Processes of one thread each that keep what they work with.

    Args:
        make: Makes it, once in each process, to which it is sent once.
        count: How many processes.

    Yields:
        The pool, and the function to give to it with each task: what `make` made there is called with the task.
    """
    with one_thread_each(), ProcessPoolExecutor(count, get_context("spawn"), _start, (make,)) as pool:
        yield pool, run_kept


def _start(make: Callable[[], Callable[[Any], Any]]) -> None:
    keep(make())


def keep(function: Callable[[Any], Any]) -> None:
    """Let `run_kept` call a function in this process from now on."""
    global _kept  # noqa: PLW0603 - a pool has no other place for what its processes keep
    _kept = function


def run_kept(task: Any) -> Any:
    """What the function that this process keeps makes of a task."""
    return _kept(task)
