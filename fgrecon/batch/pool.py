"""A pool of a few processes, each of which may die at any time without losing more than its own task.

Every worker is a pool of one process, so that a death is known to be of the piece that it was working on and of no
other: the worker is made again, and the piece tried again, then each of its parts. A part during which a worker dies
twice is given up.

Actors of a Ray cluster, whose results are streamed back here, are driven one by one likewise, and not by a dataset of
Ray Data: its restarts of actors that die cannot tell which row was to blame, and have been seen to stand still.
(`Reconstructor` itself fits `map_batches`.)
"""

from __future__ import annotations

import logging
import multiprocessing
import os
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from typing import Any, ClassVar, Generic, TypeVar

from fgrecon.core.errors import FgreconError, MissingPackageError
from fgrecon.core.processes import keep, no_interrupts, obey_parent, one_thread_each, run_kept
from fgrecon.io.arrow import without_pandas

_TRIES = 2
"""How often a piece is tried before it is taken apart, and a part before it is given up."""

_STARTS = 3
"""How often in a row a worker may die before it has begun."""

_log = logging.getLogger(__name__)

Piece = TypeVar("Piece")
Result = TypeVar("Result")


class WorkerDiedError(FgreconError, RuntimeError):
    """A process died, killed by the system or by what it was working on."""


class Worker(ABC, Generic[Piece, Result]):
    """Something that works on a piece at a time, and may die of it; made on use."""

    NOT_BEGUN: ClassVar[str]
    """What an error says of workers that die before they have begun."""

    _false_starts = 0

    @abstractmethod
    def submit(self, piece: Piece) -> Future[Result]:
        """Let it work on a piece; it is made where there is none yet."""

    @abstractmethod
    def has_begun(self) -> bool:
        """Whether the dead worker had begun to work; raises what kept it from that, if that is known."""

    @abstractmethod
    def end(self, *, whole: bool) -> None:
        """End it, at once where the work is not done as a whole; another piece may come and make it again."""

    def bury(self) -> bool:
        """Leave it behind dead, so that the next piece has a new one.

        Returns:
            Whether it had begun, so that what it worked on may be what killed it.

        Raises:
            WorkerDiedError: Worker after worker died before it had begun: there is something wrong with the place.
        """
        begun = self.has_begun()
        self._false_starts = 0 if begun else self._false_starts + 1
        if self._false_starts >= _STARTS:
            raise WorkerDiedError(f"Workers die before they have begun. {self.NOT_BEGUN}")
        self.end(whole=True)
        return begun


class _Process(Worker[Piece, Result]):
    """A process that calls a function."""

    NOT_BEGUN = "Where there is little memory, give fewer jobs; a script that starts workers needs a main guard."

    def __init__(self, function: Callable[[Piece], Result]) -> None:
        self._function = function
        self._pool: ProcessPoolExecutor | None = None
        self._begun: Future[int]

    def submit(self, piece: Piece) -> Future[Result]:
        if self._pool is not None:
            try:
                return self._pool.submit(run_kept, piece)
            except BrokenProcessPool:  # it died while it had nothing to do
                self._pool.shutdown(wait=False)
        self._pool = ProcessPoolExecutor(1, multiprocessing.get_context("spawn"))
        with one_thread_each(), no_interrupts():
            self._begun = self._pool.submit(_begin, self._function)
        return self._pool.submit(run_kept, piece)

    def has_begun(self) -> bool:
        error = self._begun.exception()
        if error is not None and not isinstance(error, BrokenProcessPool):
            raise error
        return error is None

    def end(self, *, whole: bool) -> None:
        if self._pool is None:
            return
        if not whole and self._begun.done() and self._begun.exception() is None:
            for child in multiprocessing.active_children():  # and not by its number, which may be another's by now
                if child.pid == self._begun.result():
                    child.terminate()
        self._pool.shutdown(wait=True, cancel_futures=True)
        self._pool = None


def work(
    function: Callable[[Piece], Result],
    pieces: Iterable[Piece],
    jobs: int,
    parts: Callable[[Piece], list[Piece]],
    lost: Callable[[Piece, WorkerDiedError], Result],
) -> Iterator[Result]:
    """The results of a function of many pieces, as they are done; no piece is taken before a worker is free for it.

    Args:
        function: Called in the workers, which it is sent to once; it can be pickled.
        jobs: Number of processes, each with one thread.
        parts: The parts of a piece, for one during which workers die.
        lost: The result of a part that was given up.

    Raises:
        WorkerDiedError: Workers die before they have begun.
    """
    workers: list[Worker[Piece, Result]] = [_Process(function) for _ in range(jobs)]
    return drive(workers, pieces, parts, lost, BrokenProcessPool)


def drive(
    workers: Sequence[Worker[Piece, Result]],
    pieces: Iterable[Piece],
    parts: Callable[[Piece], list[Piece]],
    lost: Callable[[Piece, WorkerDiedError], Result],
    death: type[Exception],
) -> Iterator[Result]:
    """`work` by workers of any kind.

    Args:
        parts: The parts of a piece, for one during which workers die.
        lost: The result of a part that was given up.
        death: What the future of a piece raises whose worker has died.
    """
    free, new = list(reversed(workers)), ((piece, 0) for piece in pieces)
    again: deque[tuple[Piece, int]] = deque()  # pieces, and how many workers have died of each
    busy: dict[Future[Result], tuple[Worker[Piece, Result], Piece, int]] = {}
    whole = False
    try:
        while True:
            while free and (following := again.popleft() if again else next(new, None)) is not None:
                worker = free.pop()
                busy[worker.submit(following[0])] = (worker, *following)
            for idle in free:  # what it holds may be what another waits for
                idle.end(whole=True)
            if not busy:
                break
            for future in wait(busy, return_when=FIRST_COMPLETED).done:
                worker, piece, deaths = busy.pop(future)
                free.append(worker)
                try:
                    result = future.result()
                except death:
                    deaths += worker.bury()
                    if deaths < _TRIES:
                        _log.warning("A worker died; it is made again, and its piece tried again.")
                        again.append((piece, deaths))
                        continue
                    if len(smaller := parts(piece)) > 1:
                        again.extend((part, 0) for part in smaller)
                        continue
                    result = lost(piece, WorkerDiedError("The worker died of this row, twice."))
                yield result
        whole = True
    finally:
        for worker in workers:
            worker.end(whole=whole)


def _begin(function: Callable[[Any], Any]) -> int:
    """Make a worker ready; its process number."""
    keep(function)
    without_pandas()
    obey_parent()
    return os.getpid()


_REPORT_SECONDS = 60.0
"""Within this time Ray reports that an actor is dead (not tuned)."""


class _Called:
    """What an actor is: something that calls a function, which it gets once."""

    def __init__(self, function: Callable[[Any], Any]) -> None:
        self._function = function

    def ready(self) -> bool:
        return True

    def call(self, piece: Any, ready: bool) -> Any:  # noqa: ARG002 - Ray sends nothing before the actor has begun
        return self._function(piece)


class _Actor(Worker[Piece, Result]):
    """An actor with a processor of its own."""

    NOT_BEGUN = "Install fgrecon on every node of the cluster."

    def __init__(self, function: Callable[[Piece], Result]) -> None:
        self._function = function
        self._actor: Any = None
        self._ready: Any = None
        self._begun: Future[bool]

    def submit(self, piece: Piece) -> Future[Result]:
        import ray

        if self._actor is None:
            self._actor = ray.remote(num_cpus=1, max_restarts=0)(_Called).remote(self._function)
            self._ready = self._actor.ready.remote()
            self._begun = self._ready.future()
        future: Future[Result] = self._actor.call.remote(piece, self._ready).future()
        return future

    def has_begun(self) -> bool:
        return self._begun.exception(_REPORT_SECONDS) is None

    def end(self, *, whole: bool) -> None:  # noqa: ARG002 - an idle actor and a busy one are ended alike
        import ray

        if self._actor is not None:
            ray.kill(self._actor)  # its processor is free again
            self._actor = None


def work_on_ray(
    function: Callable[[Piece], Result],
    pieces: Iterable[Piece],
    jobs: int,
    parts: Callable[[Piece], list[Piece]],
    lost: Callable[[Piece, WorkerDiedError], Result],
    address: str,
) -> Iterator[Result]:
    """`work` by actors of a Ray cluster, each with one processor; no more than the cluster has.

    Raises:
        MissingPackageError: Ray is not installed.
        WorkerDiedError: Actors cannot even begin.
    """
    try:
        import ray
    except ImportError as error:
        raise MissingPackageError("ray[data]>=2.40", "A run on Ray") from error
    if not ray.is_initialized():
        ray.init(address=address, log_to_driver=False)
    processors = max(int(ray.cluster_resources().get("CPU", 1)), 1)
    actors: list[Worker[Piece, Result]] = [_Actor(function) for _ in range(min(jobs, processors))]
    yield from drive(actors, pieces, parts, lost, ray.exceptions.RayActorError)
