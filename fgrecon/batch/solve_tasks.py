"""Vehicle tasks solved: each by itself, by several processes, or the vehicles of an image together."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from fgrecon.batch.pool import WorkerDiedError, work
from fgrecon.batch.vehicle_tasks import VehicleTask, Watch, unwatched
from fgrecon.core.camera import Camera
from fgrecon.core.errors import FgreconError, InvalidInputError
from fgrecon.core.input_warnings import InputWarnings, summed_up
from fgrecon.core.reconstruction import Reconstruction, Status
from fgrecon.core.scene_reconstruction import SceneReconstruction
from fgrecon.core.vehicle_mesh import ClosestModel, VehicleMesh, closest_model
from fgrecon.io.run_settings import RunSettings
from fgrecon.solve.pipeline import reconstruct
from fgrecon.solve.scene import reconstruct_scene, reconstruct_scenes

_PIECE = 8  # vehicles that a process gets at once

_Solved = tuple[int, Reconstruction | None, tuple[type[FgreconError], tuple[Any, ...]] | None]


@dataclass(frozen=True)
class Outcome:
    """What became of a task."""

    task: VehicleTask  # the vehicle, with the camera that was estimated
    result: Reconstruction | None  # its result, or None
    error: FgreconError | None  # the error with which it was refused, or None
    closest: ClosestModel | None = None  # the car model that the result comes nearest to, where models were given

    @property
    def name(self) -> str:
        """Id of the vehicle."""
        return self.task.instance.name


@dataclass(frozen=True)
class SolvedImage:
    """An image whose vehicles were solved together."""

    image: str | None  # its name; None where the input does not say, which makes all its vehicles one image's
    result: SceneReconstruction  # what was estimated

    def to_dict(self) -> dict[str, Any]:
        """For JSON."""
        scene = self.result
        ground, covariance = scene.ground, scene.ground_covariance
        return {
            "image": self.image,
            "message": scene.message,
            "ground": None
            if ground is None
            else {
                "normal": ground.normal.tolist(),
                "distance": ground.distance,
                "covariance": None if covariance is None else covariance.tolist(),
            },
            "focal_lengths": [{"pixels": pixels, "excess": excess} for pixels, excess in scene.focal_lengths],
            "focal_sigma": scene.camera.focal_sigma if scene.focal_lengths else None,
        }


@summed_up()
def solve_tasks(
    tasks: Sequence[VehicleTask], settings: RunSettings, *, together: bool, jobs: int = 1, watch: Watch = unwatched
) -> tuple[list[Outcome], list[SolvedImage]]:
    """Reconstruct vehicles, those of an image together or each by itself.

    Args:
        together: Whether the vehicles of an image share its ground; where a focal length is not known, they are solved
            together in any case.
        jobs: Processes, each with one thread; vehicles of an image are solved together in one.

    Returns:
        One outcome per task, in order, and the images whose vehicles were solved together.

    Raises:
        InvalidInputError: The vehicles cannot be solved together; names what cannot.
    """
    if together or any(task.camera.focal_sigma > 0.0 for task in tasks):
        return _solve_images(tasks, settings, watch)
    if jobs == 1:
        return [solve_task(task, settings) for task in watch(tasks, "Vehicles")], []
    return _solve_in_processes(tasks, settings, jobs, watch), []


@summed_up()
def solve_task(task: VehicleTask, settings: RunSettings) -> Outcome:
    """Reconstruct one vehicle; an error that fgrecon raises on purpose becomes its outcome."""
    instance = task.instance
    try:
        result = reconstruct(
            instance.observation,
            task.camera,
            initial=instance.initial,
            evidence=task.evidence,
            **settings.arguments(task.box_model),
        )
    except FgreconError as error:
        return Outcome(task, None, error)
    return Outcome(task, result, None)


def _solve_in_processes(tasks: Sequence[VehicleTask], settings: RunSettings, jobs: int, watch: Watch) -> list[Outcome]:
    numbers = range(len(tasks))
    pieces = ([(n, tasks[n]) for n in numbers[start : start + _PIECE]] for start in numbers[::_PIECE])
    solved = work(partial(_solve_piece, settings), pieces, jobs, lambda piece: [[item] for item in piece], _lost)
    outcomes: dict[int, Outcome] = {}
    for number in watch(numbers, "Vehicles"):
        while number not in outcomes:
            for n, result, error in next(solved):
                outcomes[n] = Outcome(tasks[n], result, None if error is None else error[0](*error[1]))
    for _ in solved:  # none is left: this ends the processes
        pass
    return [outcomes[number] for number in numbers]


def _solve_piece(settings: RunSettings, piece: Sequence[tuple[int, VehicleTask]]) -> list[_Solved]:
    """What a worker does; errors as what makes them, since they cannot be pickled."""
    outcomes = ((number, solve_task(task, settings)) for number, task in piece)
    return [(number, outcome.result, _made_of(outcome.error)) for number, outcome in outcomes]


def _made_of(error: FgreconError | None) -> tuple[type[FgreconError], tuple[Any, ...]] | None:
    if error is None:
        return None
    arguments = (error.field, error.value, error.fix) if isinstance(error, InvalidInputError) else error.args
    return type(error), arguments


def _lost(piece: Sequence[tuple[int, VehicleTask]], error: WorkerDiedError) -> list[_Solved]:
    return [(number, None, _made_of(error)) for number, _ in piece]


def _solve_images(
    tasks: Sequence[VehicleTask], settings: RunSettings, watch: Watch
) -> tuple[list[Outcome], list[SolvedImage]]:
    images: dict[str | None, list[int]] = {}
    for number, task in enumerate(tasks):
        if task.instance.initial is not None:
            raise InvalidInputError("together", f"instance {task.instance.name} has an initial pose", "Leave it out.")
        images.setdefault(task.instance.image, []).append(number)
    outcomes: dict[int, Outcome] = {}
    solved = []
    for image, numbers in watch(list(images.items()), "Images"):
        members = [tasks[n] for n in numbers]
        observations = [task.instance.observation for task in members]
        first = members[0]
        scene = reconstruct_scene(
            observations, first.camera, evidence=first.evidence, **settings.arguments(first.box_model)
        )
        solved.append(SolvedImage(image, scene))
        outcomes |= dict(zip(numbers, _outcomes(members, scene), strict=True))
    return [outcomes[n] for n in range(len(tasks))], solved


@summed_up()
def solve_same_camera(
    images: Sequence[tuple[str, Sequence[VehicleTask]]], settings: RunSettings
) -> list[tuple[list[Outcome], SolvedImage]]:
    """Reconstruct the vehicles of images that one camera took, whose focal length is estimated from all of them.

    Args:
        images: Name and vehicles of each image, all with the same camera.

    Returns:
        Of each image the outcomes of its vehicles, with the camera that was estimated, and its scene.
    """
    first = next(task for _, tasks in images for task in tasks)  # the boxes of all images are from one source
    observations = [[task.instance.observation for task in tasks] for _, tasks in images]
    scenes = reconstruct_scenes(observations, first.camera, **settings.arguments(first.box_model))
    return [
        (_outcomes(tasks, scene), SolvedImage(name, scene)) for (name, tasks), scene in zip(images, scenes, strict=True)
    ]


def _outcomes(tasks: Sequence[VehicleTask], scene: SceneReconstruction) -> list[Outcome]:
    """What became of each vehicle of an image, with the camera that was estimated."""
    solved = dict(zip(scene.numbers, scene.vehicles, strict=True))
    outcomes = []
    for i, task in enumerate(tasks):
        camera: Camera = replace(scene.camera, image_size=task.camera.image_size)
        outcomes.append(Outcome(replace(task, camera=camera), solved.get(i), scene.refused.get(i)))
    return outcomes


def with_closest(outcomes: Sequence[Outcome], models: Sequence[VehicleMesh]) -> list[Outcome]:
    """The outcomes, those with a pose and, where there are any models, with the closest of these.

    Raises:
        InvalidInputError: The models cannot be compared with the vehicles.
    """
    return [
        replace(outcome, closest=closest_model(outcome.result, models))
        if models and outcome.result is not None and np.isfinite(outcome.result.wireframe).all()
        else outcome
        for outcome in outcomes
    ]


def fit_warnings(outcomes: Iterable[Outcome]) -> list[str]:
    """What to warn of once vehicles are solved: of most of them hardly a keypoint fits, or sides are exchanged."""
    warnings = InputWarnings()
    count_results(warnings, outcomes)
    return warnings.lines()


def count_results(warnings: InputWarnings, outcomes: Iterable[Outcome], image: str = "") -> None:
    """Count the results of vehicles, whose names begin with their image's."""
    for outcome in outcomes:
        observation = outcome.task.usable_observation
        if outcome.result is not None and observation is not None:
            warnings.add_result(f"{image}{outcome.name}", observation, outcome.result)


def check_any(path: Path, outcomes: Sequence[Outcome]) -> bool:
    """Whether at least one vehicle was reconstructed.

    Args:
        path: The file that they are from, for the error.

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
