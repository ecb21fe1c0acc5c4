"""Cars by the thousand through `fgrecon batch`: cars a second, and the memory of all its processes over time.

Run from the repository root:
    python -m benchmarks.bench_batch [--cars 100000] [--jobs 2] [--folder DIR] [--plot FILE] [--shares 500]
    python -m benchmarks.bench_batch --images DIR ... [--shares 500]
Makes files of simulated keypoints, 10,000 cars each, runs `fgrecon batch` on them as a process tree of its own, and
looks every two seconds at the memory of the tree (`/proc`: Linux alone) and at the rows in the folder. Prints the rate,
the processor time a car, the peak of memory and its growth, and each stage's share; `--plot` draws the run. With
`--folder` the input is kept, and a run that was ended goes on where it was. `--images` tells each stage's share for
images instead.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq

from benchmarks.batch_shares import image_shares, keypoint_shares, share_lines
from benchmarks.process_tree import memory_of, usage_of_tree
from benchmarks.speed.measure import machine
from fgrecon.core.size_prior import SIZE_PRIORS
from fgrecon.io.catalogue import load_prior
from fgrecon.io.files import replacing
from fgrecon.simulation.keypoint_noise import HOURGLASS
from fgrecon.simulation.vehicles import KITTI_CAMERA
from fgrecon_research.simulation import simulate_many

SETTINGS = ("--size-prior", "kitti", "--camera-height", "1.65")
"""What the cars are solved with: the fleet's size and the ground, as they are simulated."""

_PER_FILE = 10_000
_BEGUN = 0.1  # share of the rows after which memory is to stay as it is


@dataclass(frozen=True)
class Sample:
    """The tree at one moment.

    Attributes:
        seconds: Since the run began, those of earlier parts of it included.
        rows: In the folder.
        memory: Memory of all processes, MB, that of libraries once; 0 when they have ended.
        resident: The same, that of libraries with every process.
        parent: Processor time of the process that reads and writes, seconds.
        workers: Processor time of all others.
    """

    seconds: float
    rows: int
    memory: float
    resident: float
    parent: float
    workers: float


def make_cars(folder: Path, count: int) -> list[Path]:
    """Files of simulated cars in KITTI's street, a line each; those that are there already stay."""
    fleet = load_prior("car14").for_fleet(SIZE_PRIORS["kitti"])
    files = []
    for start in range(0, count, _PER_FILE):
        size = min(_PER_FILE, count - start)
        files.append(folder / f"cars-{start:07d}-{size}.jsonl")
        if files[-1].exists():
            continue
        rng = np.random.default_rng([0, start])
        with replacing(files[-1]) as part, Path(part).open("w", encoding="utf-8") as file:
            for number in range(start, start + size):
                ((seen, _),) = simulate_many(fleet, 1, rng, HOURGLASS)
                instance = {
                    "id": f"car-{number}",
                    "K": KITTI_CAMERA.matrix.tolist(),
                    "keypoints": seen.keypoints.round(2).tolist(),
                    "confidence": seen.confidence.round(4).tolist(),
                    "box": [] if seen.box is None else seen.box.round(2).tolist(),
                }
                file.write(json.dumps(instance) + "\n")
    return files


def watched_run(files: Sequence[Path], out: Path, jobs: int) -> Iterator[Sample]:
    """Run `fgrecon batch` and look at it every two seconds until it ends.

    Raises:
        RuntimeError: It ended with an error.
    """
    command = [sys.executable, "-m", "fgrecon", "batch", *map(str, files), "--out", str(out), "--jobs", str(jobs)]
    counter, began, before = _RowCounter(out), time.monotonic(), _ended()
    cpu: dict[int, float] = {}
    with subprocess.Popen([*command, *SETTINGS, "--quiet"], env={**os.environ, "OMP_NUM_THREADS": "1"}) as run:
        while run.poll() is None:
            tree = usage_of_tree(run.pid)
            cpu |= {process: usage.cpu for process, usage in tree.items()}
            yield Sample(
                time.monotonic() - began,
                counter.rows(),
                memory_of(tree.values()),
                sum(one.resident for one in tree.values()),
                cpu.get(run.pid, 0.0),
                sum(cpu.values()) - cpu.get(run.pid, 0.0),
            )
            time.sleep(2.0)
    if run.returncode:
        raise RuntimeError(f"fgrecon batch ended with {run.returncode}")
    parent = cpu.get(run.pid, 0.0)
    yield Sample(time.monotonic() - began, counter.rows(), 0.0, 0.0, parent, _ended() - before - parent)


def _ended() -> float:
    """Processor time of all processes that this one started and that have ended, seconds."""
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime


class _RowCounter:
    """Counts the rows in a folder's parts; each part is looked at once."""

    def __init__(self, folder: Path) -> None:
        self._folder, self._known = folder, dict[Path, int]()

    def rows(self) -> int:
        """Rows of all parts."""
        for path in self._folder.glob("part-*.parquet"):
            if path not in self._known:
                self._known[path] = pq.ParquetFile(path).metadata.num_rows
        return sum(self._known.values())


def run_and_keep(files: Sequence[Path], folder: Path, jobs: int) -> list[Sample]:
    """The samples of a run, those of the parts before it was ended included; they are kept in the folder."""
    kept = folder / "samples.jsonl"
    lines = kept.read_text(encoding="utf-8").splitlines() if kept.exists() else []
    samples = [Sample(**json.loads(line)) for line in lines]
    last = samples[-1] if samples else Sample(0.0, 0, 0.0, 0.0, 0.0, 0.0)
    with kept.open("a", encoding="utf-8") as file:
        for one in watched_run(files, folder / "results", jobs):
            sums = {name: getattr(last, name) + getattr(one, name) for name in ("seconds", "parent", "workers")}
            samples.append(replace(one, **sums))
            file.write(json.dumps({name: round(value, 3) for name, value in asdict(samples[-1]).items()}) + "\n")
            file.flush()
    return samples


def summary(samples: Sequence[Sample], jobs: int) -> list[str]:
    """What is to be said of a run."""
    end, busy = samples[-1], [one for one in samples if one.memory]
    steady = [one for one in busy if one.rows >= _BEGUN * end.rows] or busy
    tenth = max(len(steady) // 10, 1)
    first, last = (float(np.median([s.memory for s in part])) for part in (steady[:tenth], steady[-tenth:]))
    parent, workers = 1e3 * end.parent / end.rows, 1e3 * end.workers / end.rows
    rate, alone = end.rows / end.seconds, jobs * 1e3 / (parent + workers)
    peak, with_each = (max(getattr(one, name) for one in busy) for name in ("memory", "resident"))
    return [
        f"{end.rows} cars in {end.seconds:.0f} s by {jobs} workers: {rate:.0f} cars/s",
        f"CPU ms a car: {parent + workers:.2f}, of them {parent:.2f} the parent; {jobs} idle cores: {alone:.0f} cars/s",
        f"memory of all processes: {peak:.0f} MB at most, libraries once ({with_each:.0f} MB with every process)",
        f"memory from {_BEGUN:.0%} of the rows to the end: {first:.1f} to {last:.1f} MB ({last - first:+.1f})",
    ]


def check(out: Path, count: int) -> str:
    """A line that says whether every row is there once, and their statuses."""
    table = pq.read_table(out, columns=["row_id", "status"])
    ids, statuses = table.column("row_id"), table.column("status").value_counts().to_pylist()
    assert len(table) == count == len(set(ids.to_pylist())), f"{len(table)} rows of {count}"
    size = sum(path.stat().st_size for path in out.glob("part-*.parquet"))
    counts = ", ".join(f"{one['counts']} {one['values']}" for one in statuses)
    return f"every row once; {counts}; {size / count / 1e3:.2f} kB a row in {len(list(out.glob('part-*')))} parts"


def plot(samples: Sequence[Sample], path: Path) -> None:
    """Memory over the cars that are written, and these over time, as SVG."""
    import matplotlib as mpl
    from matplotlib.figure import Figure

    busy = [one for one in samples if one.memory]
    style = {"svg.hashsalt": "fgrecon", "svg.fonttype": "none", "font.family": "sans-serif"}
    with mpl.rc_context(style):
        figure = Figure(figsize=(7.6, 2.6), layout="constrained")
        memory, rows = figure.subplots(1, 2)
        memory.plot([one.rows for one in busy], [one.memory for one in busy], color="#1f77b4")
        memory.set(xlabel="cars written", ylabel="memory of all processes, MB", ylim=(0, 420))
        memory.axhline(400, color="#999999", linestyle=":")
        rows.plot([one.seconds / 60.0 for one in samples], [one.rows for one in samples], color="#ff7f0e")
        rows.set(xlabel="minutes", ylabel="cars written", xlim=(0, None), ylim=(0, None))
        figure.savefig(path, format="svg", metadata={"Date": None, "Creator": None})


def main() -> None:
    """Make the cars, run, print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cars", type=int, default=100_000)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--folder", type=Path, help="keep input and results there")
    parser.add_argument("--plot", type=Path, help="SVG file")
    parser.add_argument("--images", type=Path, nargs="+", help="folders of images, instead of cars")
    parser.add_argument("--shares", type=int, default=500, help="cars or images of which the stages are timed; 0: none")
    given = parser.parse_args()
    print(*(f"{name}: {value}" for name, value in machine().items()), sep="\n")
    if given.images is not None:
        shares, cars = image_shares(given.images, given.shares)
        print(f"{cars:.1f} cars an image, one thread", *share_lines(shares, "image"), sep="\n")
        return
    with tempfile.TemporaryDirectory() as made:
        folder = Path(made) if given.folder is None else given.folder
        folder.mkdir(parents=True, exist_ok=True)
        files = make_cars(folder, given.cars)
        samples = run_and_keep(files, folder, given.jobs)
        print(*summary(samples, given.jobs), check(folder / "results", given.cars), sep="\n")
        if given.plot is not None:
            plot(samples, given.plot)
        if given.shares:
            print(*share_lines(keypoint_shares(files[0], given.shares)), sep="\n")


if __name__ == "__main__":
    main()
