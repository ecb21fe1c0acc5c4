"""The same work by actors of a Ray cluster, their rows streamed back here.

Actors are driven one by one, as processes are, and not by a dataset of Ray Data: its restarts of actors that die cannot
tell which row was to blame, and have been seen to stand still. (`Reconstructor` itself fits `map_batches`.)
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from concurrent.futures import Future
from typing import Any

from fgrecon.batch.pool import STARTS, WorkerDiedError, drive
from fgrecon.batch.rows import lost_rows, single_tasks
from fgrecon.batch.tasks import Tasks, TaskSolver
from fgrecon.core.errors import MissingPackageError

__all__ = ["work_on_ray"]


_WORD = 60.0  # seconds within which word of a dead actor comes


class _Solver:
    """What an actor is: something that solves tasks, which it gets once."""

    def __init__(self, solver: TaskSolver) -> None:
        self._solver = solver

    def ready(self) -> bool:
        """Whether it has begun."""
        return True

    def solve(self, tasks: Tasks, word: bool) -> Any:  # noqa: ARG002 - Ray sends nothing before it has the word
        """The results of tasks, which are sent once there is word that the actor has begun."""
        return self._solver(tasks)


class _Actor:
    """An actor with a processor of its own; made on use."""

    def __init__(self, solver: TaskSolver) -> None:
        self._solver = solver
        self._actor: Any = None
        self._word: Any = None
        self._ready: Future[bool] | None = None
        self._deaths = 0

    def submit(self, piece: Tasks) -> Future[Any]:
        """Let it work on tasks."""
        import ray

        if self._actor is None:
            self._actor = ray.remote(num_cpus=1, max_restarts=0)(_Solver).remote(self._solver)
            self._word = self._actor.ready.remote()
            self._ready = self._word.future()
        future: Future[Any] = self._actor.solve.remote(piece, self._word).future()
        return future

    def bury(self) -> bool:
        """Leave a dead actor behind.

        Returns:
            Whether it had begun.

        Raises:
            WorkerDiedError: Actor after actor died before it had begun.
        """
        assert self._ready is not None
        begun = self._ready.exception(_WORD) is None
        self._deaths = 0 if begun else self._deaths + 1
        if self._deaths >= STARTS:
            raise WorkerDiedError("Actors die before they have begun. Install fgrecon on every node of the cluster.")
        self._actor = None
        return begun

    def end(self, *, whole: bool) -> None:  # noqa: ARG002 - an idle actor and a busy one are ended alike
        """End the actor; its processor is free again."""
        import ray

        if self._actor is not None:
            ray.kill(self._actor)
            self._actor = None


def work_on_ray(solver: TaskSolver, batches: Iterable[Tasks], jobs: int, address: str) -> Iterator[Any]:
    """Tables of the results of tasks, as they are done.

    Args:
        solver: What does the work.
        batches: Tasks that an actor gets at once.
        jobs: Actors at most, each with one processor; no more than the cluster has.
        address: Of the cluster, or `auto`.

    Raises:
        MissingPackageError: Ray is not installed.
        WorkerDiedError: Actors cannot even begin.
    """
    try:
        import ray
    except ImportError as error:
        raise MissingPackageError("fgrecon[ray]", "A run on Ray") from error
    if not ray.is_initialized():
        ray.init(address=address, log_to_driver=False)
    processors = max(int(ray.cluster_resources().get("CPU", 1)), 1)
    actors = [_Actor(solver) for _ in range(min(jobs, processors))]
    yield from drive(actors, batches, single_tasks, lost_rows, ray.exceptions.RayActorError)
