"""fgrecon stage by stage, and the start that the paper took from another detector, as rows of tables."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from fgrecon.core.arrays import Array
from fgrecon.core.camera import Camera, Ground
from fgrecon.core.category import Category
from fgrecon.core.geometry import transform
from fgrecon.core.input_warnings import summed_up
from fgrecon.core.observation import Observation
from fgrecon.core.options import Options
from fgrecon.core.reconstruction import Reconstruction
from fgrecon.core.shape_prior import ShapePrior
from fgrecon.solve.pipeline import reconstruct
from fgrecon.solve.proposals.pose_search import search_pose
from fgrecon.solve.proposals.problem import Problem
from fgrecon.solve.proposals.starts import at_azimuths
from fgrecon.solve.vehicle.model import VehicleModel

AZIMUTH_SIGMA = 8.5
"""Standard deviation of the azimuth that stands in for Mono3D's boxes, degrees: with `AZIMUTH_GROSS` it meets what the
paper prints of Mono3D on Easy (42 / 85 / 93 % within 5 / 15 / 30 degrees, mean 15 degrees) with 41 / 86 / 94 % and 13
degrees."""

AZIMUTH_GROSS = 0.075
"""Share of these azimuths that are anywhere on the circle."""


@dataclass(frozen=True)
class StageEstimate:
    """Where a stage leaves a vehicle."""

    camera_T_object: Array  # (4, 4) pose
    keypoints: Array  # (K, 3) wireframe, object frame, metres
    box_size: Array  # (3,) length, width and height, metres

    def in_camera(self) -> Array:
        """(K, 3) wireframe in the camera frame."""
        return transform(self.camera_T_object, self.keypoints)


@summed_up()  # what an evaluation solves is measured, not warned of
def stages(
    observation: Observation, camera: Camera, prior: ShapePrior, options: Options, **given: Any
) -> dict[str, StageEstimate]:
    """The states after each stage: `pose`, `shape` (pose fixed) and `joint`, which by default are two solves.

    Args:
        options: Settings; they must keep the history.
        given: What else `fgrecon.reconstruct` is given.

    Raises:
        InvalidInputError: Something given cannot be used.
        DegenerateProblemError: The keypoints do not determine a pose.
    """
    if not options.keep_history:
        raise ValueError("The stages are read from the history: keep it.")
    result = fixed = reconstruct(observation, camera, prior=prior, options=options, **given)
    if all(step.stage != "shape" for step in result.diagnostics.history):  # the paper's own scheme has all three
        apart = replace(options, shape=replace(options.shape, joint=False))
        fixed = reconstruct(observation, camera, prior=prior, options=apart, **given)
    return stages_of(result, fixed, prior.category)


def stages_of(result: Reconstruction, fixed: Reconstruction, category: Category) -> dict[str, StageEstimate]:
    """The states `pose`, `shape` and `joint` from the histories of a result and of one with `joint=False`."""
    states = {}
    for stage, source in (("pose", result), ("shape", fixed)):
        steps = [step for step in source.diagnostics.history if step.stage == stage]
        if steps:
            last = steps[-1]
            size = np.tensordot(category.dimension_operator, last.keypoints, axes=2)
            states[stage] = StageEstimate(last.camera_T_object, last.keypoints, size)
        elif states:  # no step of its own: it ends where the one before did
            states[stage] = states["pose"]
    states["joint"] = StageEstimate(result.camera_T_object, result.wireframe, result.box_size)
    return states


def algorithm1_state(observation: Observation, camera: Camera, model: VehicleModel, options: Options) -> StageEstimate:
    """ASPnP + IRLS with the mean shape: the paper's pose adjustment alone (`options` name one of its strategies)."""
    pose = search_pose(Problem.of(observation, camera, model, None, options))
    return StageEstimate(pose.camera_T_object, model.prior.mean, model.dimension_mean)


def initial_state(box: Array, camera: Camera, model: VehicleModel, ground: Ground, rotation_y: float) -> StageEstimate:
    """The mean shape on the ground's slope at an azimuth, placed so that it fills the 2D box (4,)."""
    start = at_azimuths(box, camera, model, ground, [rotation_y], relative=False)
    return StageEstimate(start.matrices()[0], model.prior.mean, model.dimension_mean)


def noisy_azimuth(rotation_y: float, rng: np.random.Generator) -> float:
    """The true yaw with the stated noise, radians."""
    error = np.radians(AZIMUTH_SIGMA) * rng.standard_normal()
    anywhere = rng.uniform(-np.pi, np.pi)
    return rotation_y + float(anywhere if rng.random() < AZIMUTH_GROSS else error)
