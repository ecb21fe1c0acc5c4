"""Clocks and tables: what is compared runs in turn, car by car, so that what else the machine does hits all alike."""

from __future__ import annotations

import gc
import json
import os
import platform
import subprocess
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from importlib import metadata
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np

from benchmarks.speed.builds import THIS, Build
from fgrecon.core.arrays import Array

Clock = Callable[[], tuple[float, float]]
"""Runs something once and tells its milliseconds of CPU and by the clock."""

COLUMNS = ("", "CPU ms: median", "mean", "p5", "p95", "worst", "wall median", "ratio", "ratio's p5-p95")
WORKER = Path(__file__).with_name("worker.py")


@dataclass
class Table:
    """One table of the report.

    Attributes:
        title: What it is about.
        columns: Heads.
        rows: Name and cells.
        notes: Sentences under it.
    """

    title: str
    columns: Sequence[str] = COLUMNS
    rows: list[list[str | float]] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    def markdown(self) -> str:
        """The table as Markdown."""
        lines = [f"### {self.title}", ""]
        if self.rows:
            lines += [_line(self.columns), _line(["---", *["---:"] * (len(self.columns) - 1)])]
            lines += [_line([_cell(cell) for cell in row]) for row in self.rows] + [""]
        return "\n".join([*lines, *(f"{note}\n" for note in self.notes)])


def _line(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cells)} |"


def _cell(value: str | float) -> str:
    return value if isinstance(value, str) else f"{value:.4g}"


def clock(call: Callable[[], object]) -> Clock:
    """Times a call in this process."""

    def run() -> tuple[float, float]:
        wall, cpu = time.perf_counter(), time.process_time()
        call()
        return 1e3 * (time.process_time() - cpu), 1e3 * (time.perf_counter() - wall)

    return run


def interleaved(rows: Mapping[str, Sequence[Clock]], repeats: int) -> dict[str, Array]:
    """Times of all rows, (cars, repeats, 2), milliseconds of CPU and by the clock: every car in every row, in turn.

    Every other round goes through the rows backwards, so that none always comes after the same one.
    """
    names = list(rows)
    cars = {len(calls) for calls in rows.values()}
    if len(cars) != 1:
        raise ValueError(f"rows of unequal length: {cars}")
    taken = {name: np.empty((*cars, repeats, 2)) for name in names}
    gc.collect()
    for round_ in range(repeats):
        for car in range(*cars):
            for name in names[:: -1 if round_ % 2 else 1]:
                taken[name][car, round_] = rows[name][car]()
    return taken


def timing_rows(taken: Mapping[str, Array], reference: str | None = None) -> list[list[str | float]]:
    """Rows of a table: over the cars, of the least of the repeats, which a busy machine disturbs least.

    The ratio is the median over cars of CPU times to those of the reference (the first row).
    """
    unit = taken[next(iter(taken)) if reference is None else reference].min(axis=1)[:, 0]
    rows: list[list[str | float]] = []
    for name, times in taken.items():
        cpu, wall = times.min(axis=1).T
        low, median, high = np.percentile(cpu / unit, (5, 50, 95))
        spread = f"{low:.3g}-{high:.3g}"
        p5, middle, p95 = np.percentile(cpu, (5, 50, 95))
        values = [middle, cpu.mean(), p5, p95, cpu.max(), np.median(wall), median]
        rows.append([name, *map(float, values), spread])
    return rows


class Arm:
    """A process that solves the cases of a file, by a build.

    A variable of None is left out: `OMP_NUM_THREADS=None` leaves the number of threads to the libraries.
    """

    def __init__(self, cases: Path, build: Build = THIS, **environment: str | None) -> None:
        wanted = {**build.environment, "OMP_NUM_THREADS": "1", **environment}
        self._process = subprocess.Popen(
            [str(build.python), "-W", "ignore", str(WORKER), str(cases)],
            env={name: value for name, value in wanted.items() if value is not None},
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )

    def __enter__(self) -> Arm:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self._process.communicate()

    def ask(self, **request: Any) -> Any:
        """The worker's answer to a request.

        Raises:
            RuntimeError: The worker ended instead; it said why on the standard error.
        """
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        print(json.dumps(request), file=self._process.stdin, flush=True)
        line = self._process.stdout.readline()
        if not line:
            raise RuntimeError(f"the worker ended with {self._process.wait()} at {request}")
        return json.loads(line)

    def clock(self, index: int, answers: list[Any], *, history: bool = False) -> Clock:
        """Times the solve of a case, and keeps the last answer."""

        def run() -> tuple[float, float]:
            answers[index] = self.ask(solve=index, history=history)
            return answers[index].get("cpu", np.nan), answers[index].get("wall", np.nan)

        return run


def machine() -> dict[str, str]:
    """What it ran on."""
    found = {
        "CPU": f"{_processor()} ({platform.machine()})",
        "cores": str(os.cpu_count()),
        "load at the start": f"{os.getloadavg()[0]:.1f}",
        "system": f"{platform.system()} {platform.release()}",
        "Python": platform.python_version(),
    }
    for package in ("fgrecon", "numpy", "scipy", "gtsam", "opencv-python-headless", "pyceres", "poselib"):
        try:
            found[package] = metadata.version(package)
        except metadata.PackageNotFoundError:
            found[package] = "not installed"
    return found


def _processor() -> str:
    """The processor's name; Linux tells it in a file."""
    info = Path("/proc/cpuinfo")
    lines = info.read_text(encoding="utf-8").splitlines() if info.exists() else []
    return next((line.split(":")[1].strip() for line in lines if line.startswith("model name")), platform.processor())
