"""The authors' C++ on Ceres beside the shape stage: 36 points, 42 vectors, their own energy and input file.

Their program minimises reprojection under Huber's loss and a regulariser over lambda, at a fixed pose; ours has box,
sizes, planes, symmetry, visibility and weights that are made anew beside that. So the ratio is of two shape stages as
they are used, not of two solvers of one energy (see the scipy and Ceres rows for that).
"""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from benchmarks.speed.measure import Clock, Table, clock, interleaved, timing_rows
from benchmarks.speed.stages import Car

PROGRAM = "singleViewShapeAdjuster"


def authors(cars: Sequence[Car], source: Path | None, folder: Path, repeats: int) -> Table:
    """Times of both shape stages; without their source or Ceres, a table that says so."""
    table = Table("Shape stage beside the authors' C++ on Ceres: 36 points, 42 vectors")
    if source is None or not (source / f"{PROGRAM}.cc").is_file():
        table.notes.append("Left out: give the folder `ceresCode` of the authors' release with --authors.")
        return table
    folder.mkdir(parents=True, exist_ok=True)
    program = folder / PROGRAM
    if (reason := _built(source, program)) is not None:
        table.notes.append(f"Left out: {reason}")
        return table
    rows: dict[str, list[Clock]] = {
        "fgrecon: shape at a fixed pose": [clock(lambda car=car: car.refine(joint=False)) for car in cars],
        "fgrecon: shape and pose": [clock(lambda car=car: car.refine()) for car in cars],
        "fgrecon: one minimisation": [clock(car.one_solve) for car in cars],
        "the authors' solve alone": [_solver(program, car, folder / str(i)) for i, car in enumerate(cars)],
    }
    table.rows = timing_rows(interleaved(rows, repeats))
    table.notes.append(
        "Theirs: reprojection under Huber's loss and a regulariser over lambda. Ours also has visibility, weights made "
        "anew until they settle, box, sizes, symmetry and free offsets, from every proposal that matters."
    )
    return table


def _built(source: Path, program: Path) -> str | None:
    """Compile their program, its solve timed; why not, if it cannot be."""
    compiler = shutil.which("c++")
    if compiler is None:
        return "there is no C++ compiler."
    header = Path(__file__).with_name("timing.h")
    libraries = ["-lceres", "-lglog"]
    command = [compiler, "-O3", "-DNDEBUG", "-std=c++17", "-w", "-I/usr/include/eigen3", "-include", str(header)]
    command += [str(source / f"{PROGRAM}.cc"), "-o", str(program), *libraries]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode == 0:
        return None
    return f"it cannot be built (Debian: libceres-dev): {(done.stderr.strip().splitlines() or ['?'])[0]}"


def _solver(program: Path, car: Car, folder: Path) -> Clock:
    """Times their solve from our proposal; the program's start and its reading of files do not count."""
    (folder / "cache").mkdir(parents=True, exist_ok=True)
    (folder / "cache" / "shapeAdjusterInput.txt").write_text(_input(car), encoding="ascii")

    def run() -> tuple[float, float]:
        done = subprocess.run([program], cwd=folder, capture_output=True, text=True, check=True)
        cpu, wall = done.stdout.split()
        return float(cpu), float(wall)

    return run


def _input(car: Car) -> str:
    """Their input file: keypoints, weights, mean, basis, lambda, and the pose with its rotation column by column."""
    prior, seen, pose = car.problem.model.prior, car.problem.observation, car.pose.camera_T_object
    measured = np.isfinite(seen.keypoints[:, 0])
    weights = np.where(measured, 1.0 if seen.confidence is None else seen.confidence, 0.0)
    size = prior.mean.max(axis=0) - prior.mean.min(axis=0)
    rows = [
        [len(prior.mean)],
        pose[:3, 3],
        [size[1], size[2], size[0]],
        car.problem.camera.matrix,
        np.nan_to_num(seen.keypoints),
        weights,
        prior.mean,
        [len(prior.basis)],
        prior.basis,
        np.zeros(len(prior.basis)),
        pose[:3, :3].T,
        pose[:3, 3],
    ]
    return "\n".join(" ".join(f"{number:.17g}" for number in np.ravel(row)) for row in rows) + "\n"
