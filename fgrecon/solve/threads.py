"""One thread for the linear algebra of a solve, whatever BLAS would take.

The matrices of a solve are small: a thread pool gains nothing on them, and where other work keeps the cores busy every
product waits for threads that do not run. How many threads a pool has is mostly a matter of the whole process, so
solves that run side by side are counted, and the last one to end puts the numbers back. Of OpenMP every thread has a
number of its own, which each solve puts back itself.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from functools import wraps
from threading import Lock, get_ident
from typing import Any, ParamSpec, TypeVar

from fgrecon.core.compiled import lapack

P = ParamSpec("P")
T = TypeVar("T")


class _ThreadPools:
    """The thread pools of the libraries that this process has loaded, as threadpoolctl's controllers."""

    def __init__(self) -> None:
        self._lock = Lock()
        self._shared: list[Any] = []  # one number for the process: BLAS
        self._own: list[Any] = []  # one number for each thread: OpenMP, and BLAS that was built on it
        self._openblas: list[Any] = []  # the first of OpenBLAS: what threadpoolctl keeps about it, it keeps about all
        self._modules = 0  # how many modules there were when the pools were looked for
        self._users: list[int] = []  # the thread of every solve that runs
        self._before: dict[str, tuple[Any, int]] = {}  # by file: a shared pool held at one thread, and its number
        if hasattr(os, "register_at_fork"):
            os.register_at_fork(
                before=self._lock.acquire, after_in_parent=self._lock.release, after_in_child=self._after_fork
            )

    @contextmanager
    def at_one_thread(self) -> Iterator[None]:
        """Hold the pools at one thread while at least one thread of Python is in here."""
        with self._lock:
            self._look()
            own = [(pool, number) for pool in self._own if (number := pool.num_threads) != 1]
            free = [pool for pool in self._shared if pool.filepath not in self._before]
            shared = {pool.filepath: (pool, number) for pool in free if (number := pool.num_threads) != 1}
            self._before |= shared
            self._set((pool, 1) for pool, _ in [*own, *shared.values()])
            self._users.append(get_ident())
        try:
            yield
        finally:
            with self._lock:
                self._users.remove(get_ident())
                self._set(own)
                self._restore_if_unused()

    def _look(self) -> None:
        """Find the pools again if modules were imported since, which may have brought one."""
        if self._modules == len(sys.modules):
            return
        lapack()  # the search's, with a pool of its own: now rather than amid a solve
        from threadpoolctl import ThreadpoolController

        pools = ThreadpoolController().lib_controllers
        self._own = [pool for pool in pools if "openmp" in (pool.user_api, getattr(pool, "threading_layer", None))]
        self._shared = [pool for pool in pools if pool not in self._own]
        self._openblas = [pool for pool in pools if hasattr(pool, "clear_controlling_thread")][:1]
        self._modules = len(sys.modules)

    def _set(self, numbers: Iterable[tuple[Any, int]]) -> None:
        """Set numbers of threads, though another thread of Python did so before.

        threadpoolctl leaves OpenBLAS to the first thread that sets it, and ignores the others until that one gives it
        up; here the solves are counted instead.
        """
        changes = list(numbers)
        if changes:
            self._give_up()
            for pool, number in changes:
                pool.set_num_threads(number)
            self._give_up()

    def _give_up(self) -> None:
        for pool in self._openblas:
            pool.clear_controlling_thread(force=True)

    def _restore_if_unused(self) -> None:
        if not self._users and self._before:
            self._set(self._before.values())
            self._before.clear()

    def _after_fork(self) -> None:
        """In a child only the thread that forked goes on: forget the solves of the others."""
        self._users = [thread for thread in self._users if thread == get_ident()]
        self._restore_if_unused()
        self._lock.release()


_POOLS = _ThreadPools()
"""Those of this process: a number of threads is the process's, and so is the count of solves that need it at one."""


def single_threaded(function: Callable[P, T]) -> Callable[P, T]:
    """A function that runs with the thread pools of BLAS and OpenMP at one thread.

    They are as before when the last such function that runs, in whatever thread, has ended.
    """

    @wraps(function)
    def run(*args: P.args, **kwargs: P.kwargs) -> T:
        with _POOLS.at_one_thread():
            return function(*args, **kwargs)

    return run
