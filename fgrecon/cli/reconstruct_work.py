"""The work of `fgrecon reconstruct`: from files and options to one outcome per vehicle. Imported when it runs."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgrecon.batch.pool import WorkerDiedError, work
from fgrecon.cli.settings import CameraSource, Settings
from fgrecon.core.camera import Camera
from fgrecon.core.category import Category
from fgrecon.core.errors import FgreconError, InvalidInputError
from fgrecon.core.observation import Observation
from fgrecon.core.options import BoxModel
from fgrecon.core.reconstruction import Reconstruction, Status
from fgrecon.core.vehicle_mesh import ClosestModel
from fgrecon.io.json_fields import read_json
from fgrecon.io.keypoint_file import Instance, refuse_other_file
from fgrecon.io.keypoints import NOT_JSON, parse_any_keypoints, read_any_keypoints
from fgrecon.io.track_file import parse_track
from fgrecon.solve.pipeline import reconstruct

__all__ = [
    "Outcome",
    "Task",
    "check_any",
    "ground_of",
    "read_tasks",
    "run",
    "run_all",
]

_PIECE = 8  # vehicles that a process gets at once

_Solved = tuple[int, Reconstruction | None, tuple[type[FgreconError], tuple[Any, ...]] | None]


@dataclass(frozen=True)
class Task:
    """A vehicle to reconstruct.

    Attributes:
        instance: What is known about it.
        camera: The camera that saw it.
        label_offset: (3,) where KITTI's label frame lies from the camera's (a labelled point is at X + offset), or
            None.
        box_model: What its 2D box encloses, where that is not the run's setting.
    """

    instance: Instance
    camera: Camera
    label_offset: NDArray[np.float64] | None = None
    box_model: BoxModel | None = None

    @property
    def observation(self) -> Observation:
        """What was observed, for drawing; without confidences all points are alike."""
        points, confidence = self.instance.keypoints, self.instance.confidence
        trust = np.ones(len(points)) if confidence is None else confidence
        return Observation(points, trust, self.instance.box, self.instance.covariance)


@dataclass(frozen=True)
class Outcome:
    """What became of a task: a result, or the error with which it was refused."""

    task: Task
    result: Reconstruction | None
    error: FgreconError | None
    closest: ClosestModel | None = None
    """The car model that the result comes nearest to, where models were given."""

    @property
    def name(self) -> str:
        """Id of the vehicle."""
        return self.task.instance.name


def read_tasks(
    path: Path, category: Category, source: CameraSource, names: str | None = None, image: str | None = None
) -> tuple[list[Task], tuple[str, ...]]:
    """The vehicles of a file of keypoints, of any format, or of a track.

    Args:
        path: The file.
        category: Category of its keypoints.
        source: The command line's camera, which goes before the file's.
        names: What is known of the keypoints' names, or None.
        image: File name of the photograph, whose vehicles are wanted; None for all.

    Returns:
        The vehicles, and names of fields that mean nothing to fgrecon.

    Raises:
        InvalidInputError: The file is malformed, or a vehicle has no camera.
    """
    refuse_other_file(path)
    offset = None
    ignored: tuple[str, ...] = ()
    data = None if path.suffix.lower() in NOT_JSON else read_json(path)
    is_track = isinstance(data, dict) and "frames" in data and "keypoints" not in data
    if is_track:
        instances, offset = _track_instances(data, path, category)
    else:
        file = (
            read_any_keypoints(path, category, names, image)
            if data is None
            else parse_any_keypoints(data, category, names, image, where=f"{path}: ")
        )
        instances, ignored = list(file.instances), file.ignored
    camera_of = cache(source.camera)
    tasks = []
    for instance in instances:
        given, own_offset = camera_of(image if is_track else instance.image or image)
        camera = given or instance.camera
        if camera is None:
            value = f"no camera for instance {instance.name}"
            raise InvalidInputError("intrinsics", value, "Give --camera, --intrinsics, or K in the file.")
        declared = given is None and not is_track
        tasks.append(
            Task(instance, source.complete(camera, declared=declared), offset if given is None else own_offset)
        )
    return tasks, ignored


def ground_of(source: CameraSource, image: str | None) -> list[str]:
    """A line that says how to use the ground plane that a calibration file tells; none where it does not.

    Args:
        source: The command line's camera.
        image: File name of the photograph.
    """
    mounted = source.mounted(image)
    if mounted is None or mounted.ground is None:
        return []
    x, y, z = mounted.ground.normal
    plane = f"{x:.5g},{y:.5g},{z:.5g},{mounted.ground.distance:.5g}"
    return [f"{source.file} says where the ground is; --ground={plane} uses it."]


def _track_instances(data: object, path: Path, category: Category) -> tuple[list[Instance], NDArray[np.float64]]:
    """The frames of a track as instances, and its label offset."""
    track = parse_track(data, path.stem, category, where=f"{path}: ")
    nothing = np.full((category.size, 2), np.nan)
    instances = []
    for frame in track.frames:  # each frame is an image of its own, in which the vehicle is seen once
        instance = Instance(frame.name, nothing, camera=track.camera, image=frame.name)
        if (seen := frame.observation) is not None:
            instance = replace(instance, keypoints=seen.keypoints, confidence=seen.confidence, box=seen.box)
        instances.append(instance)
    return instances, track.label_offset


def run(task: Task, settings: Settings) -> Outcome:
    """Reconstruct one vehicle; an error that fgrecon raises on purpose becomes its outcome."""
    instance = task.instance
    options = settings.options
    if task.box_model is not None:
        options = replace(options, box=replace(options.box, model=task.box_model))
    try:
        result = reconstruct(
            instance.observation,
            task.camera,
            prior=settings.prior,
            ground=settings.ground,
            size_prior=settings.size_prior,
            initial=instance.initial,
            options=options,
        )
    except FgreconError as error:
        return Outcome(task, None, error)
    return Outcome(task, result, None)


def run_all(tasks: Sequence[Task], settings: Settings, jobs: int, done: Callable[[int], None]) -> list[Outcome]:
    """Reconstruct vehicles by several processes; see `run`.

    Args:
        tasks: The vehicles.
        settings: What holds for all of them.
        jobs: Number of processes, each with one thread.
        done: Called with the number of vehicles that are done.

    Returns:
        One outcome per task, in order.
    """
    numbers = range(len(tasks))
    pieces = ([(n, tasks[n]) for n in numbers[start : start + _PIECE]] for start in numbers[::_PIECE])
    found: dict[int, Outcome] = {}
    for solved in work(partial(_run_piece, settings), pieces, jobs, lambda piece: [[item] for item in piece], _lost):
        for number, result, error in solved:
            found[number] = Outcome(tasks[number], result, None if error is None else error[0](*error[1]))
        done(len(found))
    return [found[number] for number in numbers]


def _run_piece(settings: Settings, piece: Sequence[tuple[int, Task]]) -> list[_Solved]:
    """What a worker does; errors as what makes them, since they cannot be pickled."""
    return [(number, outcome.result, _made_of(outcome.error)) for number, outcome in _outcomes(piece, settings)]


def _outcomes(piece: Sequence[tuple[int, Task]], settings: Settings) -> Iterator[tuple[int, Outcome]]:
    for number, task in piece:
        yield number, run(task, settings)


def _made_of(error: FgreconError | None) -> tuple[type[FgreconError], tuple[Any, ...]] | None:
    if error is None:
        return None
    told = (error.field, error.value, error.fix) if isinstance(error, InvalidInputError) else error.args
    return type(error), told


def _lost(piece: Sequence[tuple[int, Task]], error: WorkerDiedError) -> list[_Solved]:
    return [(number, None, _made_of(error)) for number, _ in piece]


def check_any(path: Path, outcomes: Sequence[Outcome]) -> bool:
    """Whether at least one vehicle was reconstructed.

    Args:
        path: The file that they are from, for the error.
        outcomes: One per vehicle.

    Raises:
        InvalidInputError: None was, and the input is to blame for every one; it is the first one's error.
    """
    if any(outcome.result is not None and outcome.result.status is not Status.FAILED for outcome in outcomes):
        return True
    errors = [(o.name, o.error) for o in outcomes if isinstance(o.error, InvalidInputError)]
    if len(errors) < len(outcomes):
        return False
    name, error = errors[0]
    place = f"{path}: " if len(errors) == 1 else f"{path}: instance {name}: "
    raise type(error)(place + error.field, error.value, error.fix)
