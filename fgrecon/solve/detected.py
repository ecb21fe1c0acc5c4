"""A vehicle with another detector's 3D box: the box as evidence in its graph.

    detected origin, detected yaw --- X(v,t) --- keypoints, 2D box --- L(v), O(v) --- dimensions (of the box)

The box's size takes the place of a fleet's. Which way the vehicle faces is decided apart (`fgrecon.solve.independent`).
The solve refines the box (`refined`), which stays as it is where the image says little.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import gtsam
import numpy as np

from factors.detected_box import detected_origin_factor, detected_yaw_factor
from factors.keys import X
from factors.noise import diagonal_noise
from fgrecon.core.box3d import Box3D, BoxErrors
from fgrecon.core.camera import Camera
from fgrecon.core.errors import DegenerateProblemError, FgreconError
from fgrecon.core.geometry import position_covariance
from fgrecon.core.observation import Observation
from fgrecon.core.reconstruction import TRUSTED, Reconstruction
from fgrecon.core.refined_box import RefinedBox
from fgrecon.core.size_prior import LONGEST, SHORTEST, SIZES, SizePrior
from fgrecon.solve.inputs import SolveSetup
from fgrecon.solve.proposals.problem import Problem, keypoint_covariances
from fgrecon.solve.solve_settings import SCENE
from fgrecon.solve.vehicle.model import VehicleModel, sized


@dataclass(frozen=True)
class KnownBox:
    """What a detector says of a vehicle."""

    box: Box3D
    errors: BoxErrors  # how far it is off
    unsized: VehicleModel  # the prior prepared without a size, for that of the box

    def problem(self, observation: Observation, camera: Camera, setup: SolveSetup) -> Problem:
        """The vehicle as a problem to be solved.

        Args:
            observation: What is observed.
            setup: What holds for all vehicles; its sizes are for a box without one.

        Raises:
            DegenerateProblemError: The keypoints determine no pose, or the box has no vehicle's size.
        """
        options, covariance = setup.options, observation.covariance
        if covariance is None:
            covariance = np.array(keypoint_covariances(observation, options.keypoints))
        size = self.box.size
        if size is not None and not (size.min() >= SHORTEST and size.max() <= LONGEST):
            raise DegenerateProblemError("box3d.size", size.tolist(), f"Give metres: {SIZES}.")
        own = (
            setup.model_of([observation], [camera])
            if size is None
            else sized(self.unsized, SizePrior("its box", size, self.errors.size * size))
        )
        counted = replace(options, keypoints=replace(options.keypoints, common_factor=1.0))  # it is in the solve
        problem = Problem.of(
            replace(observation, covariance=SCENE.box_keypoint_inflation * covariance),
            camera,
            own,
            setup.ground,
            counted,
        )
        return replace(problem, assumed=observation.covariance is None)

    def factors(self, camera: Camera, vehicle: int = 0) -> list[gtsam.NonlinearFactor]:
        """The factors of the box on the pose of a vehicle in image 0; its size is in the vehicle's model."""
        box, errors = self.box, self.errors
        focal = np.array([camera.matrix[0, 0], camera.matrix[1, 1]])
        across, down = np.hypot(errors.bearing / focal, SCENE.box_definition_m / box.location[2]).tolist()
        noise = diagonal_noise("box_errors", np.array([across, down, errors.depth]))
        key = X(vehicle, 0)
        return [detected_origin_factor(key, box.location, noise), detected_yaw_factor(key, box.rotation_y, errors.yaw)]


def refined(given: Box3D, errors: BoxErrors, result: Reconstruction | None, error: FgreconError | None) -> RefinedBox:
    """What becomes of a box.

    Args:
        errors: How far it is off.
        result: The vehicle that was solved with it (`fgrecon.reconstruct_scene`), or None where it was refused.
        error: Why it was refused, or None.
    """
    if result is None:
        return RefinedBox(given, given, f"Unchanged: {error}")
    weak = _weak(result) or _contradiction(given, errors, result)
    covariance, size = result.uncertainty.pose_covariance, result.uncertainty.size_covariance
    if weak is not None or covariance is None or size is None:
        return RefinedBox(given, given, f"Unchanged: {weak or result.message}", result)
    return RefinedBox(
        given=given,
        box=Box3D(result.location, result.rotation_y, result.box_size),
        message=result.message,
        result=result,
        location_covariance=position_covariance(result.camera_T_object, covariance),
        yaw_sigma=float(np.sqrt(covariance[1, 1])),
        size_covariance=size,
    )


def _weak(result: Reconstruction) -> str | None:
    """Why a result says nothing; None where it says something."""
    if not result.status.determined:
        return result.message
    trusted = int(np.count_nonzero(result.diagnostics.weights >= TRUSTED))
    return (
        None
        if trusted >= SCENE.refined_keypoints
        else f"{trusted} keypoints are trusted; it takes {SCENE.refined_keypoints}."
    )


def _contradiction(given: Box3D, errors: BoxErrors, result: Reconstruction) -> str | None:
    """What speaks against a result being the box's vehicle; None where nothing does."""
    farther = float(result.location[2] / given.location[2]) - 1.0
    if abs(farther) > SCENE.refined_contradiction_sigmas * errors.depth:
        return f"The keypoints show it {100.0 * abs(farther):.0f} % {'farther' if farther > 0.0 else 'nearer'}."
    off = abs(float(np.arctan(np.tan(result.rotation_y - given.rotation_y))))  # modulo half a turn
    if off > SCENE.refined_contradiction_sigmas * errors.yaw:
        return f"The keypoints show it turned by {np.rad2deg(off):.0f} degrees against the box."
    return None
