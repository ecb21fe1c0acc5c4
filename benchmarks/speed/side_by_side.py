"""`fgrecon run` and what it is made of, in two builds in turn: the same frames, the same machine."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.bench_batch import SETTINGS as BATCH
from benchmarks.bench_batch import make_cars
from benchmarks.speed.builds import Build
from benchmarks.speed.cases import GROUND_HEIGHT, SIZE, drive, hard_cars, real_frames, streets, write_cases
from benchmarks.speed.measure import Arm, Table
from fgrecon.core.camera import Ground
from fgrecon.core.observation import Observation
from fgrecon.core.options import Options
from fgrecon.io.cameras.camera_source import CameraSource
from fgrecon.io.run_settings import RunSettings
from fgrecon.video.video_job import VideoRequest, prepare_video, track_video

DRIVE = Path("kitti_video") / "drive_0095"
"""The frames of a run, within the data."""

FPS = 10.0
MAX_DELAYS = (0.15, 0.3)
"""Seconds of a frame's delay that may be, in turn."""

PACED = Path(__file__).with_name("paced_run.py")
LIBRARIES = (
    *("ONNX Runtime", "GTSAM's elimination", "GTSAM's optimiser, callbacks in it"),
    "rows and elimination, compiled",
)
"""What `paced_run` tells of time that is no Python's."""
FIRST = Path(__file__).with_name("first_call.py")

Numbers = dict[str, float]
Measure = Callable[[Build], Numbers]


@dataclass(frozen=True)
class SideBySide:
    """Two builds, and what they are measured on.

    Attributes:
        builds: The one that others are divided by first.
        folder: For files.
        data: The real data.
        frames: Of the drive.
        repeats: How often each is run, in turn.
        cars: Of `batch`.
        long: Frames over which memory is watched.
    """

    builds: Sequence[Build]
    folder: Path
    data: Path
    frames: int = 70
    repeats: int = 3
    cars: int = 2000
    long: int = 2000

    @cached_property
    def drive(self) -> Path:
        """A folder with the first frames of the drive, as KITTI lays them out."""
        images = self.folder / "drive" / "image_02"
        images.mkdir(parents=True, exist_ok=True)
        for file in sorted((self.data / DRIVE / "image_02").iterdir())[: self.frames]:
            shutil.copy(file, images)
        shutil.copy(self.data / DRIVE / "calib.txt", images.parent)
        return images

    def command(self, *more: str, frames: Path | None = None) -> list[str]:
        """Arguments of `fgrecon run` that all runs have, and some more."""
        images = self.drive if frames is None else frames
        arguments = ("--camera-height", str(GROUND_HEIGHT), "--size-prior", SIZE)
        calibration = ("--calib", str(self.drive.parent / "calib.txt"))
        return ["run", str(images), "--fps", str(FPS), *calibration, *arguments, "--quiet", *more]

    def run(self, build: Build, *more: str) -> Numbers:
        """The whole command, its start included."""
        out = self.folder / "out"
        shutil.rmtree(out, ignore_errors=True)
        used = timed(build, ["-m", "fgrecon", *self.command(*more), "--out", str(out)], self.folder)
        return {"frames a second": self.frames / used["wall, s"], **used}

    def runs(self) -> Table:
        """The command in three ways."""
        ways = {"smoothed": (), "--online": ("--online",), "--no-estimate-motion": ("--no-estimate-motion",)}
        table = Table(f"`fgrecon run`, {self.frames} frames, start included", COLUMNS)
        for way, more in ways.items():
            table.rows += self.rows(way, lambda build, more=more: self.run(build, *more))
        table.notes.append("Memory: the most that the process has. CPU: of the process and all its threads.")
        return table

    def delays(self) -> Table:
        """From a frame's arrival to its estimates, where frames come ten times a second."""
        table = Table(f"Delay of a frame online, {self.frames} frames at {FPS:g} Hz", COLUMNS)
        table.rows = self.rows("", lambda build: self._paced(build, 1.0 / FPS, self.drive, "--online"))
        table.notes.append(
            "A frame arrives when it is due, whether the build is ready or not; its estimates are there when the "
            "tracker has them. The first ten frames, in which things are loaded, do not count."
        )
        base, *others = self.builds
        for seconds in MAX_DELAYS:
            for build in others:
                said = [self._live(build, seconds) for _ in range(self.repeats)]
                low, high = (sorted(one[key] for one in said) for key in ("median", "p95"))
                left = sorted(one["left out"] for one in said)
                table.notes.append(
                    f"{build.name}, `--max-delay {seconds:g}`, which {base.name} does not have: median {low[0]:.0f} to "
                    f"{low[-1]:.0f} ms, p95 {high[0]:.0f} to {high[-1]:.0f}; {left[0]:.0f} to {left[-1]:.0f} frames "
                    "left out."
                )
        return table

    def _live(self, build: Build, seconds: float) -> Numbers:
        """Delays in milliseconds, and how many frames are left out, where none may take longer."""
        out, report = self.folder / "out", self.folder / "live.json"
        shutil.rmtree(out, ignore_errors=True)
        command = [*self.command("--online", "--max-delay", str(seconds)), "--out", str(out), "--json", str(report)]
        timed(build, ["-m", "fgrecon", *command], self.folder)
        said = json.loads(report.read_text(encoding="utf-8"))
        delays = {name: 1e3 * delay for name, delay in said["delay_seconds"].items()}
        return {"left out": float(said["left_out"]), **delays}

    def shares(self) -> Table:
        """Where each millisecond goes: CPU time of the stages of a smoothed run."""

        def measure(build: Build) -> Numbers:
            self._paced(build, 0.0, self.drive)
            report = json.loads((self.folder / "paced.json").read_text(encoding="utf-8"))
            each = {name: 1e3 * seconds / self.frames for name, seconds in report["spent"].items()}
            least = {f"of it {name}": 1e3 * report["least"].get(name, 0.0) / self.frames for name in LIBRARIES}
            return each | {"all": sum(each.values())} | least

        table = Table(f"CPU ms a frame by stage, {self.frames} frames, smoothed", COLUMNS)
        table.rows = self.rows("", measure)
        table.notes.append(
            "What is of it ONNX Runtime's is the networks' multiplications. Compiled rows, their elimination and "
            "covariances take the place of GTSAM's elimination and of callbacks."
        )
        return table

    def memory(self) -> Table:
        """Memory over many frames, those of the drive to and fro."""
        images = self.folder / "long" / "image_02"
        images.mkdir(parents=True, exist_ok=True)
        there = sorted(self.drive.iterdir())
        way = [*there, *there[-2:0:-1]]
        for number in range(self.long):
            (images / f"{number:06d}.jpg").symlink_to(way[number % len(way)])
        table = Table(f"Memory over {self.long} frames", COLUMNS)
        one = SideBySide(self.builds, self.folder, self.data, self.frames, 1)
        for way, more in {"smoothed": (), "--online": ("--online",)}.items():
            table.rows += one.rows(way, lambda build, more=more: self._paced(build, 0.0, images, *more))
        table.notes.append("Growth: from a quarter of the frames to their end.")
        return table

    def _paced(self, build: Build, interval: float, images: Path, *more: str) -> Numbers:
        out = self.folder / "out"
        shutil.rmtree(out, ignore_errors=True)
        report = self.folder / "paced.json"
        command = [str(PACED), str(report), str(interval), *self.command(*more, frames=images), "--out", str(out)]
        used = timed(build, command, self.folder)
        found = json.loads(report.read_text(encoding="utf-8"))
        delays, memory = np.array(found["delays"][10:]), np.array(found["memory"])
        p50, p95 = 1e3 * np.percentile(delays, (50, 95))
        numbers = {"delay, ms, median": p50, "delay, ms, p95": p95, "delay, ms, worst": 1e3 * delays.max()}
        grown = {
            "memory at the end, MB": memory[-1],
            "growth, MB": memory[-1] - memory[len(memory) // 4],
            "CPU, ms a frame": 1e3 * used["CPU, s"] / len(found["memory"]),
        }
        return {name: float(value) for name, value in ((numbers if interval else {}) | grown).items()}

    def parts(self) -> Table:
        """`Tracker.update`, `reconstruct`, scenes and tracks, CPU time alone."""
        streets_ = streets(10, 6)
        cars = [*real_frames(24), *hard_cars(24)]
        file = write_cases(self.folder / "cases.json", [*cars, *(case for street in streets_ for case in street)])
        observed = write_frames(self.folder / "frames.json", self)
        swerving = write_cases(self.folder / "swerving.json", drive(200))
        places = [list(range(start, start + 10)) for start in range(len(cars), len(cars) + 60, 10)]

        def tracker(build: Build) -> Numbers:
            with Arm(file, build=build, OMP_NUM_THREADS=None) as arm:
                return {"`Tracker.update`, CPU ms a car": median(arm.ask(frames=str(observed))["cpu"])}

        def solves(build: Build) -> Numbers:
            with Arm(file, build=build, OMP_NUM_THREADS=None) as arm:
                arm.ask(solve=0)
                one = median([arm.ask(solve=i)["cpu"] for i in range(len(cars))])
                arm.ask(scene=places[0])
                ten = [arm.ask(scene=place)["cpu"] for place in places]
                alone = [sum(arm.ask(solve=i)["cpu"] for i in place) / 10 for place in places]
            shares = [scene / car for scene, car in zip(ten, alone, strict=True)]
            return {
                "`reconstruct`, CPU ms": one,
                "scene of ten, CPU ms": median(ten),
                "scene of ten, in cars by `reconstruct`": median(shares),
            }

        def tracks(build: Build) -> Numbers:
            found = {}
            for length in (15, 50, 200):
                with Arm(swerving, build=build, OMP_NUM_THREADS=None) as arm:
                    found[f"track of {length}, CPU ms an image"] = arm.ask(track=list(range(length)))["cpu"] / length
            return found

        table = Table("What it is made of", COLUMNS)
        for measure in (tracker, solves, tracks):
            table.rows += self.rows("", measure)
        return table

    def batch(self) -> Table:
        """Cars a second of `fgrecon batch` by two processes."""
        files = make_cars(self.folder, self.cars)

        def measure(build: Build) -> Numbers:
            out = self.folder / "out"
            shutil.rmtree(out, ignore_errors=True)
            arguments = [*BATCH, "--quiet", "--jobs", "2", "--out", str(out)]
            used = timed(build, ["-m", "fgrecon", "batch", *map(str, files), *arguments], self.folder)
            return {"cars a second": self.cars / used["wall, s"], "CPU, ms a car": 1e3 * used["CPU, s"] / self.cars}

        table = Table(f"`fgrecon batch --jobs 2`, {self.cars} cars of keypoints, start included", COLUMNS)
        table.rows = self.rows("", measure)
        return table

    def first(self) -> Table:
        """The first call of `reconstruct` in a fresh process."""
        file = write_cases(self.folder / "first.json", hard_cars(1))
        table = Table("First `reconstruct` in a fresh process, from its start to its end", COLUMNS)
        more = SideBySide(self.builds, self.folder, self.data, self.frames, 3 * self.repeats)
        table.rows = more.rows("", lambda build: timed(build, [str(FIRST), str(file)], self.folder))
        return table

    def rows(self, name: str, measure: Measure) -> list[list[str | float]]:
        """Rows of a table: every build is measured in turn, every other round backwards.

        Each row has the median of the rounds for each build, and that of the rounds' ratios; with the least and the
        most of both.
        """
        taken: dict[str, list[Numbers]] = {build.name: [] for build in self.builds}
        for round_ in range(self.repeats):
            for build in self.builds[:: -1 if round_ % 2 else 1]:
                taken[build.name].append(measure(build))
        rows: list[list[str | float]] = []
        base, *others = taken.values()
        for other in others:
            for what in base[0]:
                before, now = (np.array([numbers[what] for numbers in some]) for some in (base, other))
                ratios = now / np.where(before == 0.0, np.nan, before)
                cells = [part for values in (before, now, ratios) for part in (float(np.median(values)), _span(values))]
                rows.append([f"{name}: {what}" if name else what, *cells])
        return rows


COLUMNS = ("", "base", "least to most", "this tree", "least to most", "ratio", "least to most")


def _span(values: NDArray[np.float64]) -> str:
    return f"{values.min():.3g}-{values.max():.3g}"


def median(values: Sequence[float]) -> float:
    """The median."""
    return float(np.median(values))


def timed(build: Build, arguments: Sequence[str], folder: Path) -> Numbers:
    """Run Python with some arguments; seconds by the clock and of CPU, and the most memory that the process had.

    Raises:
        RuntimeError: It ended with an error.
    """
    began = time.perf_counter()
    with (folder / "said.txt").open("w+", encoding="utf-8") as said:
        process = subprocess.Popen(
            [str(build.python), "-W", "ignore", *arguments], env=build.environment, cwd=folder, stdout=said, stderr=said
        )
        _, status, used = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
        wall = time.perf_counter() - began
        if process.returncode:
            said.seek(0)
            raise RuntimeError(f"{build.name}: {' '.join(arguments)} ended with {process.returncode}: {said.read()}")
    return {"wall, s": wall, "CPU, s": used.ru_utime + used.ru_stime, "memory, MB": 1.024e-3 * used.ru_maxrss}


def write_frames(path: Path, about: SideBySide) -> Path:
    """A file of what the drive's frames show, by id, as this tree's networks see it, with the camera's poses."""
    settings = RunSettings.of("car14", Ground.level(GROUND_HEIGHT), SIZE, Options(keep_history=False))
    camera = CameraSource(calib=about.drive.parent / "calib.txt")
    out = path.with_suffix("")
    job = prepare_video(VideoRequest(str(about.drive), out, settings, camera, fps=FPS, online=True), print)
    frames = [
        {
            "time": frame.time,
            "world_T_camera": None if frame.world_T_camera is None else frame.world_T_camera.tolist(),
            "vehicles": {str(identity): _plain(seen) for identity, seen in frame.observations.items()},
        }
        for frame in track_video(job, print).frames
    ]
    content = {"camera": job.camera.matrix.tolist(), "ground": GROUND_HEIGHT, "size": SIZE, "frames": frames}
    path.write_text(json.dumps(content), encoding="utf-8")
    return path


def _plain(observation: Observation) -> dict[str, Any]:
    names = ("keypoints", "confidence", "box", "covariance", "azimuth")
    arrays = {name: getattr(observation, name).tolist() for name in names}
    return {**arrays, "confidence_midpoint": observation.confidence_midpoint}
