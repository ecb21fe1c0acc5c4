"""From keypoints to pose and shape: the stages in order."""

from __future__ import annotations

from pathlib import Path
from time import perf_counter

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fgrecon.camera import Camera, Ground
from fgrecon.catalogue import load_prior
from fgrecon.checks import as_finite, as_shape
from fgrecon.model import prepare
from fgrecon.observation import Observation
from fgrecon.options import Options
from fgrecon.pose.adjust import PoseEstimate, adjust_pose
from fgrecon.pose.problem import build_problem, keypoint_covariances
from fgrecon.pose.search import PoseProblem
from fgrecon.pose.starts import Box3D
from fgrecon.pose.visibility import clearance, occluder, probability
from fgrecon.priors.shape_prior import ShapePrior
from fgrecon.priors.size_prior import SizePrior
from fgrecon.priors.size_prior import size_prior as named_size_prior
from fgrecon.reconstruction import Reconstruction, Status, rotation_y
from fgrecon.shape.adjust import ShapeEstimate, adjust_shape, graph_weights
from fgrecon.shape.covariance import Covariances, covariances
from fgrecon.shape.graph import Scene, VehicleGraph, build

__all__ = ["reconstruct"]

Array = NDArray[np.float64]

_LOOSE = np.deg2rad(30.0)  # a rotation known no better than this is not determined


def reconstruct(
    keypoints: ArrayLike,
    intrinsics: Camera | ArrayLike,
    *,
    confidence: ArrayLike | None = None,
    box: ArrayLike | None = None,
    covariance: ArrayLike | None = None,
    distortion: ArrayLike | None = None,
    prior: ShapePrior | str | Path = "car14",
    ground: Ground | float | None = None,
    size_prior: SizePrior | str | None = None,
    initial: Box3D | float | None = None,
    options: Options | None = None,
) -> Reconstruction:
    """Recover the pose and the shape of one vehicle from its keypoints in one image.

    Args:
        keypoints: (K, 2) pixels (u, v) in the prior's keypoint order; NaN where a keypoint was not found.
        intrinsics: Camera matrix (3, 3), or (fx, fy, cx, cy), or a `Camera`.
        confidence: (K,) in [0, 1]; None where the detector gives none.
        box: (4,) 2D box x1, y1, x2, y2 in pixels, or None.
        covariance: (K, 2, 2) covariance of each keypoint in square pixels, or None.
        distortion: OpenCV distortion coefficients, or None.
        prior: Shape prior, or its name, or the path of its file.
        ground: Ground plane; a number is the height in metres of a level camera; None assumes nothing.
        size_prior: Fleet (`kitti`, `apollo79`), or a size prior; None takes sizes from the shape prior.
        initial: 3D box to start from as well, or a guess of rotation_y in radians to trust within 45 degrees.
        options: Settings.

    Returns:
        The reconstruction; its `status` tells how far to trust it.

    Raises:
        InvalidInputError: An argument cannot be used; names it, its value and the fix.
        DegenerateProblemError: The keypoints do not determine a pose.
    """
    options = Options() if options is None else options
    shape_prior = load_prior(prior)
    camera = Camera.of(intrinsics, distortion)
    plane = _ground(ground)
    start = _initial(initial)
    fleet = None if size_prior is None else named_size_prior(size_prior)
    observation = _observe(keypoints, confidence, box, covariance, camera, shape_prior, options)
    model = prepare(shape_prior, fleet, options.basis_vectors)

    started = perf_counter()
    pose = adjust_pose(observation, camera, model, plane, start, options)
    posed = perf_counter()
    problem = build_problem(observation, camera, model, plane, options)
    scene = Scene(observation, camera, model, plane, problem.box, options)
    shape = adjust_shape(scene, problem, pose)
    shaped = perf_counter()
    uncertainty = _uncertainty(scene, problem, shape)
    milliseconds = {"pose": (posed - started) * 1e3, "shape": (shaped - posed) * 1e3}
    return _result(scene, pose, shape, uncertainty, milliseconds)


def _ground(ground: Ground | float | None) -> Ground | None:
    if ground is None or isinstance(ground, Ground):
        return ground
    return Ground.level(float(as_finite("ground", ground, (), "Give a `Ground`, or the camera's height in metres.")))


def _initial(initial: Box3D | float | None) -> Box3D | float | None:
    if initial is None or isinstance(initial, Box3D):
        return initial
    return float(as_finite("initial", initial, (), "Give a `Box3D`, or a guess of rotation_y in radians."))


def _observe(
    keypoints: ArrayLike,
    confidence: ArrayLike | None,
    box: ArrayLike | None,
    covariance: ArrayLike | None,
    camera: Camera,
    prior: ShapePrior,
    options: Options,
) -> Observation:
    size = prior.category.size
    fix = f"Give {size} pixels (u, v) in the order of category {prior.category.name}; NaN where not found."
    pixels = as_shape("keypoints", keypoints, (size, 2), fix)
    # Without confidences each point is as likely right as wrong, which the visibility and the residuals then settle.
    trust = (
        np.full(size, options.confidence_midpoint)
        if confidence is None
        else as_shape("confidence", confidence, (size,))
    )
    observation = Observation(
        pixels,
        trust,
        None if box is None else np.asarray(box),
        None if covariance is None else as_shape("covariance", covariance, (size, 2, 2)),
    )
    if camera.distortion is None:
        return observation
    ideal_box = None
    if observation.box is not None:
        ideal_box = camera.undistort(observation.box.reshape(2, 2)).ravel()
    return Observation(camera.undistort(pixels), observation.confidence, ideal_box, observation.covariance)


def _uncertainty(scene: Scene, problem: PoseProblem, shape: ShapeEstimate) -> Covariances | None:
    """Covariances from the joint graph at the result, whichever stage came last."""
    vehicle = VehicleGraph(scene, shape.pose, pose_free=True)
    values = vehicle.values(shape.pose, shape.coefficients, shape.offsets)
    weights = graph_weights(problem, shape.weights, shape.visibility)
    return covariances(vehicle, build(vehicle.terms(weights, shape.box_weights)), values)


def _result(
    scene: Scene,
    pose: PoseEstimate,
    shape: ShapeEstimate,
    uncertainty: Covariances | None,
    milliseconds: dict[str, float],
) -> Reconstruction:
    prior = scene.model.prior
    camera_T_object = shape.pose.matrix()
    wireframe = prior.keypoints(shape.coefficients, shape.offsets)
    in_camera = wireframe @ camera_T_object[:3, :3].T + camera_T_object[:3, 3]
    surface = occluder(prior)
    vertices = surface.vertices(shape.coefficients)
    centre = -camera_T_object[:3, :3].T @ camera_T_object[:3, 3]
    status, message = _status(pose, uncertainty, scene.options, shape)
    sigma = np.sqrt(np.sqrt(np.linalg.det(keypoint_covariances(scene.observation, scene.options))))
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
        wireframe_uv=scene.camera.distort(scene.camera.project(in_camera)),
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
    )


def _status(
    pose: PoseEstimate, uncertainty: Covariances | None, options: Options, shape: ShapeEstimate
) -> tuple[Status, str]:
    if shape.failure is not None:
        return Status.FAILED, f"The shape stage failed ({shape.failure}); this is the state before."
    if uncertainty is None:
        return Status.DEGENERATE, "The keypoints with any weight leave pose or shape undetermined."
    turn = float(np.sqrt(np.linalg.eigvalsh(uncertainty.pose[:3, :3])[-1]))
    if turn > _LOOSE:
        return Status.DEGENERATE, f"The orientation is known to {np.rad2deg(turn):.0f} degrees only (1 sigma)."
    close = [a for a in pose.alternatives if a.excess <= options.ambiguity_margin]
    if close:
        turn = rotation_y(close[0].camera_T_object) - rotation_y(pose.camera_T_object)
        degrees = abs(np.rad2deg((turn + np.pi) % (2.0 * np.pi) - np.pi))
        return Status.AMBIGUOUS, f"A pose turned by {degrees:.0f} degrees is only {close[0].excess:.1f} nats worse."
    return Status.CONVERGED, "The pose search and the shape stage found one pose and a minimum there."
