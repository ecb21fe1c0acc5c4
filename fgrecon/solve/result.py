"""From the state at which the optimisation ended to the result, and how far to trust it."""

from __future__ import annotations

import numpy as np

from fgrecon.core.options import Options
from fgrecon.core.reconstruction import GraphFactor, Reconstruction, Status, rotation_y
from fgrecon.solve.graph.adjust import ShapeEstimate
from fgrecon.solve.graph.covariance import Covariances
from fgrecon.solve.proposals.adjust import PoseEstimate
from fgrecon.solve.proposals.problem import Problem, keypoint_covariances
from fgrecon.solve.vehicle.visibility import clearance, occluder, probability

__all__ = ["build_result"]

_LOOSE = np.deg2rad(30.0)  # a rotation known no better than this is not determined


def build_result(
    problem: Problem,
    pose: PoseEstimate,
    shape: ShapeEstimate,
    uncertainty: Covariances | None,
    graph: tuple[GraphFactor, ...],
    milliseconds: dict[str, float],
) -> Reconstruction:
    """Everything about the result that is told to the user.

    Args:
        problem: What was solved.
        pose: Result of the pose stage.
        shape: Result of the shape stage.
        uncertainty: Covariances at the result, or None where the graph does not determine them.
        graph: The factors at the result, or none where they are not wanted.
        milliseconds: Wall time by stage.
    """
    prior = problem.model.prior
    camera_T_object = shape.pose.matrix()
    wireframe = prior.keypoints(shape.coefficients, shape.offsets)
    in_camera = wireframe @ camera_T_object[:3, :3].T + camera_T_object[:3, 3]
    surface = occluder(prior)
    vertices = surface.vertices(shape.coefficients)
    centre = -camera_T_object[:3, :3].T @ camera_T_object[:3, 3]
    status, message = _status(pose, uncertainty, problem.options, shape)
    sigma = np.sqrt(np.sqrt(np.linalg.det(keypoint_covariances(problem.observation, problem.options.keypoints))))
    with np.errstate(divide="ignore"):
        sigmas = sigma / np.sqrt(shape.weights)
    return Reconstruction(
        status=status,
        message=message,
        category=prior.category.name,
        prior=prior.name,
        keypoint_names=prior.category.keypoints,
        camera_T_object=camera_T_object,
        coefficients=shape.coefficients,
        offsets=shape.offsets,
        wireframe=wireframe,
        wireframe_uv=problem.camera.distort(problem.camera.project(in_camera)),
        edges=np.array(prior.category.edges, dtype=np.int64).reshape(-1, 2),
        box_size=prior.box_size(shape.coefficients, shape.offsets),
        weights=shape.weights,
        sigmas=sigmas,
        visibility=probability(clearance(vertices, surface.faces, wireframe, centre)),
        pose_covariance=None if uncertainty is None else uncertainty.pose,
        coefficients_covariance=None if uncertainty is None else uncertainty.coefficients,
        keypoint_covariance=None if uncertainty is None else uncertainty.keypoints,
        energies=shape.energies,
        alternatives=pose.alternatives,
        history=pose.history + shape.history,
        milliseconds=milliseconds,
        surface_vertices=None if prior.surface is None else vertices,
        surface_faces=None if prior.surface is None else surface.faces.astype(np.int64),
        faces={face.name: face.keypoints for face in prior.category.faces},
        symmetric_pairs=np.array(prior.category.symmetric_pairs, dtype=np.int64).reshape(-1, 2),
        graph=graph,
    )


def _status(
    pose: PoseEstimate, uncertainty: Covariances | None, options: Options, shape: ShapeEstimate
) -> tuple[Status, str]:
    if shape.failure is not None:
        return Status.FAILED, f"The shape stage failed ({shape.failure}); this is the state before."
    if uncertainty is None:
        return Status.DEGENERATE, "The keypoints with any weight leave pose or shape undetermined."
    if shape.unfinished is not None:
        return Status.DEGENERATE, f"The solver was stopped {shape.unfinished}: near a minimum, not at one."
    turn = float(np.sqrt(np.linalg.eigvalsh(uncertainty.pose[:3, :3])[-1]))
    if turn > _LOOSE:
        return Status.DEGENERATE, f"The orientation is known to {np.rad2deg(turn):.0f} degrees only (1 sigma)."
    close = [a for a in pose.alternatives if a.excess <= options.ambiguity_margin]
    if close:
        turn = rotation_y(close[0].camera_T_object) - rotation_y(pose.camera_T_object)
        degrees = abs(np.rad2deg((turn + np.pi) % (2.0 * np.pi) - np.pi))
        return Status.AMBIGUOUS, f"A pose turned by {degrees:.0f} degrees is only {close[0].excess:.1f} nats worse."
    return Status.CONVERGED, "The pose search and the shape stage found one pose and a minimum there."
