"""Which stage of `fgrecon batch` takes what share of the processor, in one process: for keypoints and for images."""

from __future__ import annotations

import pickle
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from itertools import islice
from pathlib import Path
from typing import Any
from unittest.mock import patch

import fgrecon.batch.reconstructor
import fgrecon.batch.solve_tasks
import fgrecon.solve.pipeline
from fgrecon.batch import Reconstructor, sources_of
from fgrecon.batch.parts import Parts
from fgrecon.batch.rows import storable
from fgrecon.batch.schema import TaskSolver

Shares = Mapping[str, float]
"""Milliseconds of processor time a unit, by stage."""

_AT_ONCE = {"cars": 32, "images": 8}
_WARM = 1  # tables before the clock starts: libraries, prior and networks are loaded by the first
_REPEATS = 3  # of which the least counts, which a busy machine disturbs least
_KEYPOINTS = {
    (fgrecon.batch.reconstructor, "parse_any_keypoints"): "read keypoints",
    (fgrecon.solve.pipeline, "single_pose"): "solve: proposals",
    (fgrecon.solve.pipeline, "minimise_from_proposals"): "solve: graph",
    (fgrecon.solve.pipeline, "results"): "solve: covariances and result",
    (fgrecon.solve.pipeline, "reconstruct"): "solve: the rest",
    (fgrecon.batch.reconstructor, "solved_row"): "rows of results",
    (fgrecon.batch.reconstructor, "table_of"): "rows of results",
}
_IMAGES = {
    (fgrecon.batch.reconstructor.Pictures, "get"): "read the image",
    (fgrecon.batch.reconstructor.NanodetVehicleDetector, "__call__"): "detector",
    (fgrecon.batch.reconstructor, "tasks_in_boxes"): "keypoints",
    (fgrecon.batch.solve_tasks, "solve_tasks"): "solve",
}


class Clocked:
    """Processor time of stages that call each other: what an inner one takes is none of the outer one's."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self._stack: list[str] = []
        self._since = 0.0

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Count what is done inside to a stage."""
        self._switch()
        self._stack.append(name)
        try:
            yield
        finally:
            self._switch()
            self._stack.pop()

    def wrap(self, name: str, function: Callable[..., Any]) -> Callable[..., Any]:
        """The function, counted to a stage."""

        def counted(*args: Any, **kwargs: Any) -> Any:
            with self.stage(name):
                return function(*args, **kwargs)

        return counted

    def _switch(self) -> None:
        now = time.process_time()
        if self._stack:
            self.seconds[self._stack[-1]] = self.seconds.get(self._stack[-1], 0.0) + now - self._since
        self._since = now


def keypoint_shares(file: Path, cars: int) -> Shares:
    """Milliseconds a car of the first cars of a file, size and ground given, by stage."""
    return _shares([file], cars, "cars", _KEYPOINTS, size_prior="kitti", ground=1.65)[0]


def image_shares(inputs: Sequence[Path], images: int) -> tuple[Shares, float]:
    """Milliseconds an image by stage on one thread, of the first images of some inputs; and cars an image."""
    return _shares(inputs, images, "images", _IMAGES, ground=1.65, threads=1)


def share_lines(shares: Shares, unit: str = "car") -> list[str]:
    """A table: milliseconds and share of each stage."""
    total = sum(shares.values())
    rows = [f"| {name} | {value:.3f} | {100.0 * value / total:.1f} % |" for name, value in shares.items()]
    return [
        f"| stage | CPU ms a{'n' if unit == 'image' else ''} {unit} | share |",
        "|---|---:|---:|",
        *rows,
        f"| all | {total:.3f} | 100 % |",
    ]


def _shares(
    inputs: Sequence[Path],
    count: int,
    unit: str,
    functions: Mapping[tuple[Any, str], str],
    **settings: Any,
) -> tuple[Shares, float]:
    """Milliseconds by stage, and vehicles for each row of the input."""
    clock, solver, size = Clocked(), TaskSolver(Reconstructor(**settings)), _AT_ONCE[unit]
    rows = (row for source in sources_of(inputs) for row in source.rows())
    done = vehicles = 0
    with tempfile.TemporaryDirectory() as folder:
        parts = Parts(Path(folder))
        for number in range(_WARM + -(-count // size)):
            if number == _WARM:
                clock.seconds.clear()
            with clock.stage("read the file"):
                content = [storable(row) for row in islice(rows, size)]
            if not content:
                break
            results = _solved(clock, solver, content, functions)
            with clock.stage("write the parts"):
                parts.add(results)
            if number >= _WARM:
                done += len(content)
                vehicles += len(results) - results.column("id").null_count
        with clock.stage("write the parts"):
            parts.flush()
    return {name: 1e3 * seconds / done for name, seconds in clock.seconds.items()}, vehicles / done


def _solved(
    total: Clocked, solver: TaskSolver, content: Sequence[Mapping[str, Any]], functions: Mapping[tuple[Any, str], str]
) -> Any:
    """The results of tasks; what each stage took at least in a few repeats is added to the total."""
    least: dict[str, float] = {}
    for _ in range(_REPEATS):
        clock = Clocked()
        with clock.stage("hand over"):
            tasks = pickle.loads(pickle.dumps(content, protocol=5))
        with clock.stage("the rest"), _counted(clock, functions):
            results = solver(tasks)
        with clock.stage("hand over"):
            results = pickle.loads(pickle.dumps(results, protocol=5))
        least |= {name: min(seconds, least.get(name, seconds)) for name, seconds in clock.seconds.items()}
    for name, seconds in least.items():
        total.seconds[name] = total.seconds.get(name, 0.0) + seconds
    return results


@contextmanager
def _counted(clock: Clocked, functions: Mapping[tuple[Any, str], str]) -> Iterator[None]:
    """Count functions to stages."""
    held = [
        patch.object(where, name, clock.wrap(stage, getattr(where, name))) for (where, name), stage in functions.items()
    ]
    for one in held:
        one.start()
    try:
        yield
    finally:
        for one in reversed(held):
            one.stop()
