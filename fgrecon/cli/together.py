"""The vehicles of each image on one ground, seen by one camera: `fgrecon reconstruct --together`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from fgrecon.cli.reconstruct_work import Outcome, Task
from fgrecon.cli.settings import Settings
from fgrecon.cli.terminal import Screen
from fgrecon.core.camera import Ground
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.scene_reconstruction import SceneReconstruction
from fgrecon.solve.scene import reconstruct_scene, reconstruct_scenes

__all__ = ["Scene", "grounds_of", "solve_same_camera", "solve_together", "wants_together"]


@dataclass(frozen=True)
class Scene:
    """An image whose vehicles were solved together.

    Attributes:
        image: Its name; None where the input does not say, which makes all its vehicles one image's.
        result: What was found.
    """

    image: str | None
    result: SceneReconstruction

    def lines(self) -> list[str]:
        """What is worth telling beside the vehicles."""
        told = [] if self.image is None else [f"{self.image}:"]
        told += repr(self.result).splitlines()[: -len(self.result.vehicles) or None]
        return told

    def plain(self) -> dict[str, Any]:
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


def grounds_of(tasks: Sequence[Task], settings: Settings, scenes: Sequence[Scene]) -> dict[str | None, Ground | None]:
    """The ground of each image, by its name: the one that its vehicles found, or what was told."""
    return {task.instance.image: settings.ground for task in tasks} | {s.image: s.result.ground for s in scenes}


def wants_together(tasks: Sequence[Task]) -> bool:
    """Whether a camera's focal length is unknown, which vehicles tell together."""
    return any(task.camera.focal_sigma > 0.0 for task in tasks)


def solve_together(tasks: Sequence[Task], settings: Settings, screen: Screen) -> tuple[list[Outcome], list[Scene]]:
    """Reconstruct the vehicles of each image together.

    Args:
        tasks: The vehicles.
        settings: What holds for all of them.
        screen: Where progress is shown.

    Returns:
        One outcome per task, with the camera that was found; and the images.

    Raises:
        InvalidInputError: The vehicles cannot be solved together; names what cannot.
    """
    images: dict[str | None, list[int]] = {}
    for number, task in enumerate(tasks):
        if task.instance.initial is not None:
            raise InvalidInputError("together", f"instance {task.instance.name} has an initial pose", "Leave it out.")
        images.setdefault(task.instance.image, []).append(number)
    outcomes: dict[int, Outcome] = {}
    scenes = []
    for image, numbers in screen.watch(list(images.items()), "Images"):
        own = [tasks[n] for n in numbers]
        scene = reconstruct_scene([task.instance.observation for task in own], own[0].camera, **_told(own, settings))
        scenes.append(Scene(image, scene))
        outcomes |= dict(zip(numbers, _outcomes(own, scene), strict=True))
    return [outcomes[n] for n in range(len(tasks))], scenes


def solve_same_camera(
    images: Sequence[tuple[str, Sequence[Task]]], settings: Settings
) -> list[tuple[list[Outcome], Scene]]:
    """Reconstruct the vehicles of images that one camera took, whose focal length they tell together.

    Args:
        images: Name and vehicles of each image, all with the same camera.
        settings: What holds for all of them.

    Returns:
        Of each image the outcomes of its vehicles, with the camera that was found, and its scene.
    """
    tasks = [task for _, some in images for task in some]
    seen = [[task.instance.observation for task in some] for _, some in images]
    scenes = reconstruct_scenes(seen, tasks[0].camera, **_told(tasks, settings))
    return [(_outcomes(some, scene), Scene(name, scene)) for (name, some), scene in zip(images, scenes, strict=True)]


def _outcomes(tasks: Sequence[Task], scene: SceneReconstruction) -> list[Outcome]:
    """What became of each vehicle of an image, with the camera that was found."""
    solved = dict(zip(scene.numbers, scene.vehicles, strict=True))
    outcomes = []
    for i, task in enumerate(tasks):
        seen_by = replace(scene.camera, image_size=task.camera.image_size)
        outcomes.append(Outcome(replace(task, camera=seen_by), solved.get(i), scene.refused.get(i)))
    return outcomes


def _told(tasks: Sequence[Task], settings: Settings) -> dict[str, Any]:
    """What the solver is told beside the vehicles and their camera."""
    options, model = settings.options, tasks[0].box_model
    if model is not None:  # the boxes of an image are from one source
        options = replace(options, box=replace(options.box, model=model))
    return {
        "prior": settings.prior,
        "ground": settings.ground,
        "size_prior": settings.size_prior,
        "options": options,
    }
