"""Output of `fgrecon demo`: errors by stage, table, JSON, keypoint file. Imported when it runs."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich.table import Table

from fgrecon.cli.terminal import compact_table
from fgrecon.core.arrays import Array
from fgrecon.core.category import Category
from fgrecon.core.observation import Observation
from fgrecon.core.reconstruction import Reconstruction, rotation_y
from fgrecon.core.shape_prior import ShapePrior
from fgrecon.io.export.results import DEMO_FORMAT
from fgrecon.simulation.keypoint_noise import OUTLIER
from fgrecon.simulation.sample import GROUND, DemoScene, SampleStreet, sample_street
from fgrecon.simulation.vehicles import SimulatedTruth
from fgrecon.solve.pipeline import reconstruct
from fgrecon.viz import DrawnVehicle, Truth, scene_picture
from fgrecon.viz.describe import describe_bounds
from fgrecon.viz.subjects import ORIENTATION_ERROR, SHAPE_ERROR, TRANSLATION_ERROR

_TITLES = {"initialisation": "initial", "pose": "after pose", "shape": "after shape", "joint": "after both"}


@dataclass(frozen=True)
class Stage:
    """The estimate at the end of a stage of the optimisation."""

    title: str  # name of the stage
    camera_T_object: Array  # (4, 4) pose
    box_size: Array  # (3,) length, width and height, metres
    errors: dict[str, float]  # distances from the truth, by the names of `fgrecon.viz.subjects`


def true_values(truth: SimulatedTruth) -> Truth:
    """Pose, size and keypoints that an observation was made from."""
    vehicle = truth.vehicle
    return Truth(truth.camera_T_object, _size(vehicle.category, vehicle.keypoints), vehicle.keypoints)


def stages(result: Reconstruction, category: Category, truth: Truth) -> list[Stage]:
    """The stages that ran, in order; the first is the start."""
    last = {step.stage: step for step in result.diagnostics.history}
    return [
        Stage(
            title,
            last[name].camera_T_object,
            _size(category, last[name].keypoints),
            dict(truth.errors(last[name].camera_T_object, last[name].keypoints)),
        )
        for name, title in _TITLES.items()
        if name in last
    ]


def _size(category: Category, keypoints: Array) -> Array:
    """(3,) length, width and height in metres by keypoints (K, 3)."""
    return np.tensordot(category.dimension_operator, keypoints, axes=2)


def table(truth: Truth, estimates: Iterable[Stage]) -> Table:
    """Truth and estimates, one row each; it fits into 80 columns.

    The last three columns are the errors of yaw, position and 3D keypoints (in the object frame, their mean).
    """
    headings = ("", "yaw °", "x, y, z m", "l, w, h m", "Δ yaw", "Δ pos", "Δ 3D")
    result = compact_table(*headings, text=("",), no_wrap=True)
    size = () if truth.box_size is None else truth.box_size
    result.add_row("truth", *_pose_cells(truth.camera_T_object, size), "", "", "")
    for stage in estimates:
        result.add_row(
            stage.title,
            *_pose_cells(stage.camera_T_object, stage.box_size),
            f"{stage.errors[ORIENTATION_ERROR]:.1f}°",
            f"{stage.errors[TRANSLATION_ERROR]:.2f} m",
            f"{100 * stage.errors[SHAPE_ERROR]:.1f} cm",
        )
    return result


def _pose_cells(pose: Array, size: Iterable[float]) -> tuple[str, str, str]:
    place, extent = (", ".join(f"{number:.2f}" for number in numbers) for numbers in (pose[:3, 3], size))
    return f"{np.degrees(rotation_y(pose)):.1f}", place, extent


def in_words(scene: DemoScene, result: Reconstruction) -> tuple[str, ...]:
    """Lines about what was simulated and what became of it."""
    hidden, wrong = ~scene.truth.visible, scene.truth.outlier
    count, both = len(scene.observation.keypoints), (wrong & hidden).sum()
    bounds = describe_bounds(result)
    return (
        f"A simulated car with {count} keypoints: {hidden.sum()} are hidden.",
        f"{wrong.sum()} ({both} of them hidden) are measured more than {100 * OUTLIER:.0f} % of its box off.",
        f"{result.status.value}: {result.message}",
        *([f"Distance and yaw, {bounds}."] if bounds else []),
    )


def next_commands(scene: DemoScene, out: Path) -> tuple[str, str]:
    """Lines about commands that go on with what was written into a folder."""
    again = f"{out / 'keypoints.json'} --image {out / 'image.png'} --camera-height {scene.ground.distance:g}"
    return (
        f"Play it back with: fgrecon replay {out / 'recording.rrd'}",
        f"Do it again with: fgrecon reconstruct {again}",
    )


def document(
    seed: int, scene: DemoScene, truth: Truth, estimates: Iterable[Stage], result: Reconstruction
) -> dict[str, Any]:
    """The result as plain values for JSON."""
    size = () if truth.box_size is None else truth.box_size.tolist()
    return {
        "format": DEMO_FORMAT,
        "seed": seed,
        "truth": {
            **_pose_to_dict(truth.camera_T_object),
            "box_size": size,
            "keypoints": scene.truth.vehicle.keypoints.tolist(),
            "visible": scene.truth.visible.tolist(),
            "outlier": scene.truth.outlier.tolist(),
        },
        "stages": [
            {
                "stage": stage.title,
                **_pose_to_dict(stage.camera_T_object),
                "box_size": stage.box_size.tolist(),
                "errors": stage.errors,
            }
            for stage in estimates
        ],
        "result": result.to_dict(),
    }


def _pose_to_dict(pose: Array) -> dict[str, Any]:
    return {"camera_T_object": pose.tolist(), "rotation_y": rotation_y(pose), "location": pose[:3, 3].tolist()}


def street_picture(prior: ShapePrior, seed: int) -> Any:
    """The picture of a simulated street: each car's start and result over the image and from above, with the truth."""
    street = sample_street(prior, seed)
    return scene_picture(
        street.image, solved_street(prior, street), street.camera, ground=GROUND, before=True, beside=True
    )


def solved_street(prior: ShapePrior, street: SampleStreet) -> list[DrawnVehicle]:
    """The cars of a street, reconstructed, with the truth."""
    shown = []
    for number, car in enumerate(street.cars, start=1):
        result = reconstruct(car.observation, street.camera, prior=prior, ground=GROUND)
        shown.append(DrawnVehicle(number, car.truth.box, result, truth=true_values(car.truth)))
    return shown


def keypoint_file(scene: DemoScene, category: Category) -> dict[str, Any]:
    """The observation as `fgrecon reconstruct` reads it."""
    return {
        "K": scene.camera.matrix.tolist(),
        "image_size": scene.camera.image_size,
        **observation_to_dict(scene.observation, category),
    }


def observation_to_dict(observation: Observation, category: Category) -> dict[str, Any]:
    """Box and keypoints by name of one instance of a keypoint file."""
    rows = np.column_stack([observation.keypoints, observation.confidence])
    return {
        "box": None if observation.box is None else observation.box.tolist(),
        "keypoints": {
            name: row.tolist() for name, row in zip(category.keypoints, rows, strict=True) if np.isfinite(row).all()
        },
    }
