"""Starts of the pose search: all around from a 2D box, from a guess, from a 3D box, from PnP."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from factors.native import native
from fgrecon.core.arrays import Array
from fgrecon.core.box3d import Box3D
from fgrecon.core.camera import MIN_DEPTH, Camera, Ground
from fgrecon.core.errors import DegenerateProblemError
from fgrecon.core.geometry import yaw_rotation
from fgrecon.core.observation import Observation
from fgrecon.solve.proposals.aspnp import aspnp
from fgrecon.solve.proposals.problem import Problem
from fgrecon.solve.proposals.search_settings import SETTINGS
from fgrecon.solve.proposals.terms import Hypotheses
from fgrecon.solve.vehicle.model import VehicleModel


def all_starts(problem: Problem, initial: Box3D | float | Array | None = None) -> Hypotheses:
    """Where the search of a problem begins: in the 2D box at azimuths all around, and what PnP or `initial` says.

    Args:
        problem: What is to be solved.
        initial: As `fgrecon.solve.proposals.pose_search.search_pose` takes it.

    Raises:
        DegenerateProblemError: There is neither a box nor enough points for one.
    """
    camera, model, ground = problem.camera, problem.model, problem.ground
    box = view_box(problem.observation)
    if isinstance(initial, int | float):
        azimuths = float(initial) + np.array(SETTINGS.heading_guess_radians)
        return at_azimuths(box, camera, model, ground, azimuths, relative=False)
    foreseen = initial if isinstance(initial, np.ndarray) else None
    count = max(problem.options.search.azimuths // (1 if foreseen is None else SETTINGS.foreseen_azimuth_divisor), 1)
    clock = 2.0 * np.pi * np.arange(count) / count
    parts = [at_azimuths(box, camera, model, ground, clock, relative=True)]
    if isinstance(initial, Box3D):
        parts.append(from_box3d(initial, model, ground, problem.options.search.basis_vectors))
    if foreseen is not None:
        parts.append(Hypotheses.at_poses(foreseen, model.prior.dimension))
    else:
        parts.append(_from_aspnp(problem))
    return Hypotheses.joined(parts)


def _from_aspnp(problem: Problem) -> Hypotheses:
    """The minima of ASPnP with the confidences as weights; none where it finds the points degenerate."""
    prior = problem.model.prior
    none = np.zeros((0, 4, 4))
    weights = problem.energy.keypoints.evidence.right
    used = np.flatnonzero(weights > SETTINGS.pnp_least_right_probability)
    if len(used) < SETTINGS.pnp_least_keypoints:
        return Hypotheses.at_poses(none, prior.dimension)
    rays = problem.camera.rays(problem.observation.keypoints[used])[:, :2]
    try:
        solutions = aspnp(prior.mean[used], rays, weights[used], every=False)
    except DegenerateProblemError:
        return Hypotheses.at_poses(none, prior.dimension)
    return Hypotheses.at_poses(np.array([solution.camera_T_object for solution in solutions]), prior.dimension)


def view_box(observation: Observation) -> Array:
    """(4,) the 2D box, or the box around the points that the detector believes in, a tenth wider on each side.

    Raises:
        DegenerateProblemError: Neither is there.
    """
    if observation.box is not None:
        return observation.box
    believed = observation.measured & (observation.confidence >= 0.5 * observation.confidence.max(initial=0.0))
    points = observation.keypoints[believed if believed.sum() >= 3 else observation.measured]
    if len(points) < 2 or np.ptp(points, axis=0).max() < 1.0:
        raise DegenerateProblemError("keypoints", f"{len(points)} points", "Give more points, or a 2D box.")
    low, high = points.min(axis=0), points.max(axis=0)
    margin = 0.1 * float((high - low).max())
    return np.concatenate([low - margin, high + margin])


def at_azimuths(
    box: Array, camera: Camera, model: VehicleModel, ground: Ground | None, azimuths: ArrayLike, *, relative: bool
) -> Hypotheses:
    """The mean shape at several azimuths, each placed so that its outline fills the 2D box.

    Args:
        box: (4,) 2D box, pixels.
        model: Prepared prior.
        ground: Its normal is the vehicle's down axis; without it the camera is taken to be level.
        azimuths: (H,) radians.
        relative: Whether the azimuths are relative to the viewing ray (alpha) or absolute (rotation_y).
    """
    ray = camera.rays((box[:2] + box[2:]) / 2.0)
    angles = np.asarray(azimuths, dtype=np.float64)
    if relative:
        angles = angles + np.arctan2(ray[0], ray[2])
    rotation = yaw_rotation(angles)
    if ground is not None:
        rotation = ground.upright @ rotation
    low, high, nearest = _extents(model.outline.mean, rotation, ray)
    width, height = (high - low)[:, 0], (high - low)[:, 1]
    # The mean of what width and height say about the depth: a shape unlike the mean errs less so.
    depth = np.sqrt(camera.matrix[0, 0] * width / (box[2] - box[0]) * camera.matrix[1, 1] * height / (box[3] - box[1]))
    depth = np.maximum(depth, 2.0 * MIN_DEPTH - nearest)
    translation = ray * depth[:, None]
    translation[:, :2] -= (low + high) / 2.0
    return Hypotheses(rotation, translation, np.zeros((len(angles), model.prior.dimension)))


def _extents(points: Array, rotation: Array, ray: Array) -> tuple[Array, Array, Array]:
    """Least and greatest (H, 2) place of turned points across the viewing ray, and the least depth (H,).

    Off the optical axis what shows is not the extent along the camera's x and y.
    """
    kernel = native("fgrecon.solve._native")
    if kernel is not None:
        low, high, nearest = kernel.extents(
            np.ascontiguousarray(points), np.ascontiguousarray(rotation), float(ray[0]), float(ray[1])
        )
        return low, high, nearest
    turned = points @ rotation.transpose(0, 2, 1)
    across = turned[..., :2] - ray[:2] * turned[..., 2:]
    return across.min(axis=1), across.max(axis=1), turned[..., 2].min(axis=1)


def from_box3d(box: Box3D, model: VehicleModel, ground: Ground | None, count: int | None = None) -> Hypotheses:
    """One start at a 3D box, with the coefficients (the first so many) whose box comes closest to its size."""
    rotation = yaw_rotation([box.rotation_y])
    if ground is not None:
        rotation = ground.upright @ rotation
    coefficients = np.zeros(model.prior.dimension)
    basis = model.dimension_basis[:, :count]
    if box.size is not None and basis.size:
        # Most probable coefficients of this size to within 5 cm: the posterior mean under N(0, I).
        gain = basis.T @ np.linalg.inv(basis @ basis.T + 0.05**2 * np.eye(3))
        coefficients[:count] = gain @ (box.size - model.dimension_mean)
    return Hypotheses(rotation, box.location[None], coefficients[None])
