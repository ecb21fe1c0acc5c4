"""How fast the solver is beside its first release and other solvers, and that its results are the same.

Run from the repository root:
    python -m benchmarks.speed [--out FOLDER] [--quick] [--authors FOLDER] [--only PART ...]
    python -m benchmarks.speed --run [--base FOLDER] [--frames N] [--repeats N] [--out FOLDER] [--quick] [--only PART]

With `--run` the whole of `fgrecon run` and what it is made of is measured instead, in this tree and in the build of an
earlier commit in turn, with the threads that both take by themselves.

Milliseconds depend on the machine, ratios hardly: what is compared runs in turn within one run, car by car, and CPU
time of the process stands beside the wall time. Without the real data (FGRECON_DATA or ../shared/data) only simulated
cars are solved.
"""

from __future__ import annotations

import os
import sys

if "--run" not in sys.argv:
    os.environ.setdefault("OMP_NUM_THREADS", "1")

import argparse
import json
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path

from benchmarks.speed import floors, sections
from benchmarks.speed.arms import compare
from benchmarks.speed.authors import authors
from benchmarks.speed.builds import THIS, base_build
from benchmarks.speed.cases import Case, hard_cars, marked_cars, real_frames
from benchmarks.speed.measure import Table, machine
from benchmarks.speed.side_by_side import SideBySide
from benchmarks.speed.stages import Car
from fgrecon.io.catalogue import load_prior
from tests.conftest import data_root


@dataclass
class Run:
    """What a run has: its size, its cars and a folder for files.

    Attributes:
        folder: For files of the run.
        quick: Few cars, once.
        source: The authors' C++, if any.
    """

    folder: Path
    quick: bool
    source: Path | None

    @property
    def repeats(self) -> int:
        """How often each car is solved in each row."""
        return 2 if self.quick else 5

    @cached_property
    def kinds(self) -> dict[str, list[Case]]:
        """Cars by what they are; those that are absent are left out."""
        found = {
            "frames of real tracks": real_frames(12 if self.quick else 76),
            "simulated, hard": hard_cars(12 if self.quick else 60),
        }
        return {name: cases for name, cases in found.items() if cases}

    @cached_property
    def cars(self) -> dict[str, list[Car]]:
        """The same, prepared."""
        prior = load_prior("car14")
        return {name: [Car.of(case, prior) for case in cases] for name, cases in self.kinds.items()}

    def stages(self) -> list[Table]:
        """One car of 14 points, stage by stage."""
        return [sections.one_car(kind, cars, self.repeats) for kind, cars in self.cars.items()]

    def versions(self) -> list[Table]:
        """Beside the first release, and without the compiled kernel."""
        marked = {"ApolloCar3D": marked_cars(12 if self.quick else 60)}
        times, differences = compare({**self.kinds, **marked}, self.folder, self.repeats)
        return [*times, differences]

    def large(self) -> list[Table]:
        """36 points and 42 vectors, beside other solvers."""
        few = next(iter(self.cars.values()))[: 2 if self.quick else 6]
        tables = [sections.one_minimisation("14 points, 5 vectors", few, 2)]
        data = data_root()
        if data is None or not (data / "icra2017").is_dir():
            return [
                *tables,
                Table("36 points, 42 vectors", notes=["Left out: the authors' release is not in the data."]),
            ]
        _, cars = sections.large_cars(data / "icra2017")
        tables += [sections.large(cars, 2 * self.repeats), sections.one_minimisation("36 points, 42 vectors", cars, 2)]
        return [*tables, authors(cars, self.source, self.folder / "authors", 2 * self.repeats)]

    def tracks(self) -> list[Table]:
        """Tracks of growing length."""
        return [sections.tracks(self.folder, (15, 50) if self.quick else (15, 50, 200), 1 if self.quick else 2)]

    def scenes(self) -> list[Table]:
        """Images of several cars."""
        return [sections.scenes((2, 5, 10), 4 if self.quick else 20, self.repeats)]

    def results(self) -> list[Table]:
        """How far results are from converged."""
        count, prior = 2 if self.quick else 10, load_prior("car14")
        kinds = {kind: cars[:: max(1, len(cars) // count)][:count] for kind, cars in self.cars.items()}
        kinds["ApolloCar3D"] = [Car.of(case, prior) for case in marked_cars(count)]
        return [sections.equal(kinds)]

    def least(self) -> list[Table]:
        """What a frame needs at least."""
        return [floors.networks(3 * self.repeats), floors.elimination(3 * self.repeats)]

    def steady(self) -> list[Table]:
        """Memory over many solves, and bits in threads and processes."""
        cases = next(iter(self.kinds.values()))
        return list(sections.steady(self.folder, cases, 200 if self.quick else 5000))


RUN_PARTS: dict[str, Callable[[SideBySide], Table]] = {
    "runs": SideBySide.runs,
    "shares": SideBySide.shares,
    "delays": SideBySide.delays,
    "parts": SideBySide.parts,
    "batch": SideBySide.batch,
    "first": SideBySide.first,
    "memory": SideBySide.memory,
}
"""Those of `--run`."""

PARTS: dict[str, Callable[[Run], list[Table]]] = {
    "stages": Run.stages,
    "versions": Run.versions,
    "large": Run.large,
    "tracks": Run.tracks,
    "scenes": Run.scenes,
    "results": Run.results,
    "least": Run.least,
    "steady": Run.steady,
}


def main() -> int:
    """Run the benchmark."""
    arguments = _arguments()
    found = machine()
    command = f"<!-- Made by `{' '.join(['python -m benchmarks.speed', *sys.argv[1:]])}`. -->"
    head = [command, "", f"{', '.join(f'{name} {value}' for name, value in found.items())}.", ""]
    print("\n".join(head))
    tables: list[Table] = []
    started = time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        for table in (_side_by_side if arguments.run else _alone)(Path(folder), arguments):
            tables.append(table)
            print(table.markdown(), flush=True)
    print(f"{time.perf_counter() - started:.0f} s", file=sys.stderr)
    if arguments.out is not None:
        arguments.out.mkdir(parents=True, exist_ok=True)
        markdown = "\n".join([*head, *(table.markdown() for table in tables)])
        (arguments.out / "speed.md").write_text(markdown, encoding="utf-8")
        document = {"machine": found, "tables": [asdict(table) for table in tables]}
        (arguments.out / "speed.json").write_text(json.dumps(document, indent=1), encoding="utf-8")
    return 0


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, help="folder for speed.md and speed.json")
    parser.add_argument("--quick", action="store_true", help="few cars, few repeats: whether it works, in two minutes")
    parser.add_argument("--authors", type=Path, metavar="FOLDER", help="`ceresCode` of the authors' release (C++)")
    parser.add_argument("--run", action="store_true", help="`fgrecon run` in two builds in turn")
    parser.add_argument("--base", type=Path, metavar="FOLDER", help="keeps the earlier build, and takes the one there")
    parser.add_argument("--frames", type=int, default=70, help="of `fgrecon run`")
    parser.add_argument("--repeats", type=int, help="how often each build is measured with --run (3)")
    names = f"{', '.join(PARTS)}; with --run {', '.join(RUN_PARTS)}"
    parser.add_argument("--only", nargs="+", metavar="PART", help=names)
    arguments = parser.parse_args()
    known = list(RUN_PARTS if arguments.run else PARTS)
    arguments.only = arguments.only or known
    if unknown := [part for part in arguments.only if part not in known]:
        parser.error(f"--only {' '.join(unknown)}: give {', '.join(known)}")
    return arguments


def _alone(folder: Path, arguments: argparse.Namespace) -> Iterator[Table]:
    run = Run(folder, arguments.quick, arguments.authors)
    for part in arguments.only:
        yield from PARTS[part](run)


def _side_by_side(folder: Path, arguments: argparse.Namespace) -> Iterator[Table]:
    data = data_root()
    if data is None:
        raise SystemExit("--run needs the real data: FGRECON_DATA, or ../shared/data.")
    quick = arguments.quick
    size = {"frames": 15, "repeats": 1, "cars": 100, "long": 40} if quick else {"frames": arguments.frames}
    size |= {} if arguments.repeats is None else {"repeats": arguments.repeats}
    builds = (base_build(arguments.base or folder / "base"), THIS)
    both = SideBySide(builds, folder, data, **size)
    for part in arguments.only:
        yield RUN_PARTS[part](both)


if __name__ == "__main__":
    sys.exit(main())
