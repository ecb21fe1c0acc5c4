"""Runs the simulated validation set: in parallel, resumable, and the same whatever the number of processes."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import as_completed
from dataclasses import dataclass, fields
from functools import partial
from importlib import metadata
from pathlib import Path

import numpy as np

from fgrecon.calibration.labelled_frames import SceneKnowledge
from fgrecon.core.processes import processes_with
from fgrecon.core.robust import StrategyName
from fgrecon.io.catalogue import load_category
from fgrecon.io.files import stored
from fgrecon.io.kitti_calibration import read_calibration
from fgrecon.io.kitti_files import Objects
from fgrecon.simulation.keypoint_noise import HOURGLASS
from fgrecon.simulation.vehicles import Vehicle
from fgrecon.solve.vehicle.conditioning import of_fleet
from fgrecon_research.io.kitti_sets import Fault, read_detections, read_image_set, read_labels
from fgrecon_research.paper.simulated import Fleet, KittiFrame, simulate_frame
from fgrecon_research.paper.simulated_scores import (
    CHAIN_ROWS,
    MAIN_ROWS,
    RowSolver,
    Scores,
    row_solvers,
    score_instances,
)
from fgrecon_research.simulation import harder
from fgrecon_research.training.priors.apollo79 import Apollo79

_FRAMES_A_PART = 24


@dataclass(frozen=True)
class PaperSettings:
    """What `evaluate_paper` runs on."""

    data: Path  # folder of the data
    out: Path  # folder for parts and KITTI result files
    scene: SceneKnowledge  # prior, ground and fleet
    workers: int = 1  # number of processes; results do not depend on it
    every: int = 1  # take every so many-th part of the simulated set; 1 for all
    seed: int = 0  # seed of everything random
    fresh: bool = False  # work on everything again, whatever parts are stored


@dataclass(frozen=True)
class Condition:
    """One set of rows under one level of noise."""

    name: str
    severity: float  # how much worse the keypoints are than the fitted network's (`NoiseModel.harder`)
    every: int  # take every so many-th part of the frames
    rows: tuple[str, ...]  # what runs


CONDITIONS = (
    Condition("validation", 0.0, 1, MAIN_ROWS),
    Condition("harder", 1.0, 10, MAIN_ROWS),
    Condition("chain", 0.0, 10, CHAIN_ROWS),
    Condition("strategies", 0.0, 20, tuple(f"fgrecon+ground+size:{name.value}" for name in StrategyName)),
)


@dataclass(frozen=True)
class Validation:
    """KITTI's validation set as it was read."""

    frames: tuple[KittiFrame, ...]  # the frames that have labels and a camera
    problems: tuple[Fault, ...]  # what was wrong with the files


@dataclass(frozen=True)
class ConditionResult:
    """Result of a condition."""

    condition: Condition
    scores: Scores  # all instances, in the order of frames and label files
    solved: int  # instances that were worked on now; the others had been stored
    seconds: float  # wall time of that


def read_validation(folder: Path) -> Validation:
    """Read labels, cameras and 2D detections of the validation set in KITTI's object layout.

    Args:
        folder: Has `ImageSets`, `training/label_2`, `training/calib` and `detections_2d/rgb_detection_val.txt`.

    Raises:
        InvalidInputError: The image set, the detections or a camera cannot be read.
    """
    names = read_image_set(folder / "ImageSets" / "val.txt")
    labels, problems = read_labels(folder / "training" / "label_2", names)
    detections, more = read_detections(folder / "detections_2d" / "rgb_detection_val.txt", names)
    frames = tuple(
        KittiFrame(
            name, labels[name], detections[name], read_calibration(folder / "training" / "calib" / f"{name}.txt")
        )
        for name in names
        if name in labels
    )
    return Validation(frames, (*problems, *more))


def vehicles_of(models: Apollo79) -> tuple[Vehicle, ...]:
    """The car models as shapes to simulate."""
    category = load_category("car14")
    pairs = zip(models.keypoints, models.vertices, strict=True)
    return tuple(Vehicle(category, keypoints, vertices, models.faces) for keypoints, vertices in pairs)


@dataclass(frozen=True)
class _Job:
    """Some frames of one condition, and the file for their scores."""

    condition: Condition
    frames: tuple[KittiFrame, ...]
    path: Path


class _Worker:
    """What a process needs, made once: shapes and, by condition, solvers."""

    def __init__(self, scene: SceneKnowledge, vehicles: Sequence[Vehicle], sizes: np.ndarray, seed: int) -> None:
        self.scene, self.vehicles, self.sizes, self.seed = scene, vehicles, sizes, seed
        self.mean = of_fleet(scene.prior, scene.size).mean
        self.solvers: dict[str, tuple[RowSolver, ...]] = {}

    def __call__(self, job: _Job) -> int:
        """Write the job's scores; the number of instances."""
        name = job.condition.name
        if name not in self.solvers:
            self.solvers[name] = row_solvers(job.condition.rows, self.scene, self.seed)
        fleet = Fleet(self.vehicles, self.sizes, harder(HOURGLASS, job.condition.severity), self.seed)
        instances = [instance for frame in job.frames for instance in simulate_frame(frame, fleet)]
        score_instances(instances, job.condition.rows, self.solvers[name], self.mean).write(job.path)
        return len(instances)


def run_conditions(
    validation: Validation,
    conditions: Sequence[Condition],
    models: Apollo79,
    settings: PaperSettings,
    advance: Callable[[str, int, int], None] = lambda *_: None,
) -> Mapping[str, ConditionResult]:
    """Score every condition; parts that an earlier run finished with the same inputs are read, not made again.

    A whole run takes over the parts of one that took every so many-th part of what a condition takes.

    Args:
        settings: What the methods know, where parts are stored, and how much is run.
    """
    outcomes: dict[str, ConditionResult] = {}
    make = partial(_Worker, settings.scene, vehicles_of(models), models.size, settings.seed)
    with processes_with(make, settings.workers) as (pool, run):
        for condition in conditions:
            place = settings.out / "parts" / condition.name
            place.mkdir(parents=True, exist_ok=True)
            parts = _parts(validation)[:: condition.every * settings.every]
            inputs = _digest(condition, settings.scene, models, settings.seed)
            jobs = [_Job(condition, part, place / f"{part[0].name}-{_part_digest(inputs, part)}.npz") for part in parts]
            missing = [job for job in jobs if settings.fresh or stored(job.path, Scores.read) is None]
            advance(condition.name, len(jobs) - len(missing), len(jobs))
            started, solved = time.perf_counter(), 0
            waiting = [pool.submit(run, job) for job in missing]
            for done, future in enumerate(as_completed(waiting), start=len(jobs) - len(missing) + 1):
                solved += future.result()
                advance(condition.name, done, len(jobs))
            seconds = time.perf_counter() - started
            scores = Scores.join([Scores.read(job.path) for job in jobs])
            outcomes[condition.name] = ConditionResult(condition, scores, solved, seconds)
    return outcomes


def _parts(validation: Validation) -> list[tuple[KittiFrame, ...]]:
    """The frames a few at a time: what one process works on and one file holds."""
    frames = validation.frames
    return [frames[start : start + _FRAMES_A_PART] for start in range(0, len(frames), _FRAMES_A_PART)]


def _digest(condition: Condition, scene: SceneKnowledge, models: Apollo79, seed: int) -> bytes:
    """Changes with everything but the frames that a result depends on, save for unreleased changes of the code."""
    ground = scene.ground
    plane = (ground.normal.tolist(), ground.distance, ground.height_sigma, ground.slope_sigma, ground.tilt_sigma)
    noise = harder(HOURGLASS, condition.severity)
    plain = (metadata.version("fgrecon"), condition.rows, seed, noise, scene.prior.name, plane)
    arrays = [scene.prior.mean, scene.prior.basis, scene.size.mean, scene.size.sigma, models.keypoints, models.vertices]
    digest = hashlib.sha256(repr(plain).encode())
    for array in arrays:
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.digest()


def _part_digest(inputs: bytes, frames: Sequence[KittiFrame]) -> str:
    """Changes with the rest of the inputs and with what the frames hold."""
    digest = hashlib.sha256(inputs)
    for frame in frames:
        digest.update(frame.name.encode())
        arrays = [frame.calibration.camera.matrix, frame.calibration.label_offset]
        for objects in (frame.labels, frame.detections):
            digest.update("".join(objects.kind).encode())
            arrays += [getattr(objects, f.name) for f in fields(Objects) if f.name != "kind"]
        for array in arrays:
            digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()[:12]
