"""A run by actors of a Ray cluster, their rows streamed back here.

Actors are driven one by one, as processes are, and not by a dataset of Ray Data: its restarts of actors that die cannot
tell which row was to blame, and have been seen to stand still. (`Reconstructor` itself fits `map_batches`.)
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from concurrent.futures import Future
from typing import Any

from fgrecon.batch.pool import Worker, drive
from fgrecon.batch.rows import lost_rows, single_tasks
from fgrecon.batch.schema import Tasks, TaskSolver
from fgrecon.core.errors import MissingPackageError

_REPORT_SECONDS = 60.0
"""Within this time Ray reports that an actor is dead (not tuned)."""


class _Solver:
    """What an actor is: something that solves tasks, which it gets once."""

    def __init__(self, solver: TaskSolver) -> None:
        self._solver = solver

    def ready(self) -> bool:
        return True

    def solve(self, tasks: Tasks, ready: bool) -> Any:  # noqa: ARG002 - Ray sends nothing before the actor has begun
        return self._solver(tasks)


class _Actor(Worker[Tasks, Any]):
    """An actor with a processor of its own."""

    NOT_BEGUN = "Install fgrecon on every node of the cluster."

    def __init__(self, solver: TaskSolver) -> None:
        self._solver = solver
        self._actor: Any = None
        self._ready: Any = None
        self._begun: Future[bool]

    def submit(self, piece: Tasks) -> Future[Any]:
        import ray

        if self._actor is None:
            self._actor = ray.remote(num_cpus=1, max_restarts=0)(_Solver).remote(self._solver)
            self._ready = self._actor.ready.remote()
            self._begun = self._ready.future()
        return self._actor.solve.remote(piece, self._ready).future()

    def has_begun(self) -> bool:
        return self._begun.exception(_REPORT_SECONDS) is None

    def end(self, *, whole: bool) -> None:  # noqa: ARG002 - an idle actor and a busy one are ended alike
        import ray

        if self._actor is not None:
            ray.kill(self._actor)  # its processor is free again
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
        raise MissingPackageError("ray[data]>=2.40", "A run on Ray") from error
    if not ray.is_initialized():
        ray.init(address=address, log_to_driver=False)
    processors = max(int(ray.cluster_resources().get("CPU", 1)), 1)
    actors = [_Actor(solver) for _ in range(min(jobs, processors))]
    yield from drive(actors, batches, single_tasks, lost_rows, ray.exceptions.RayActorError)
