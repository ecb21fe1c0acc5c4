"""From keypoints to pose and shape: the stages in order."""

from __future__ import annotations

from pathlib import Path
from time import perf_counter

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fgrecon.core.box3d import Box3D
from fgrecon.core.camera import Camera, Ground
from fgrecon.core.checks import as_finite, as_shape
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.observation import Observation
from fgrecon.core.options import Options
from fgrecon.core.reconstruction import GraphFactor, Reconstruction
from fgrecon.core.shape_prior import ShapePrior
from fgrecon.core.size_prior import SizePrior
from fgrecon.core.size_prior import size_prior as named_size_prior
from fgrecon.io.catalogue import load_prior
from fgrecon.solve.graph.adjust import ShapeEstimate, adjust_shape
from fgrecon.solve.graph.covariance import Covariances, covariances
from fgrecon.solve.graph.graph import Scene, VehicleGraph, build
from fgrecon.solve.graph.state import graph_weights
from fgrecon.solve.graph.structure import graph_factors
from fgrecon.solve.proposals.adjust import adjust_pose
from fgrecon.solve.proposals.problem import build_problem
from fgrecon.solve.proposals.search import PoseProblem
from fgrecon.solve.result import build_result
from fgrecon.solve.vehicle.model import prepare

__all__ = ["ground_plane", "observe", "reconstruct"]

Array = NDArray[np.float64]


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
        size_prior: Fleet (`kitti`, `apollo79`), or a size prior; one so tight that it is a single vehicle's tells its
            shape as well (`fgrecon.solve.vehicle.conditioning`). None takes sizes from the shape prior.
        initial: 3D box to start from as well, or a guess of rotation_y in radians to trust within 45 degrees.
        options: Settings.

    Returns:
        The reconstruction; its `status` tells how far to trust it.

    Raises:
        InvalidInputError: An argument cannot be used; names it, its value and the fix.
        DegenerateProblemError: The keypoints do not determine a pose.
    """
    options = Options() if options is None else options
    if not isinstance(options, Options):
        raise InvalidInputError("options", options, "Give an `fgrecon.Options`.")
    shape_prior = load_prior(prior)
    camera = Camera.of(intrinsics, distortion)
    plane = ground_plane(ground)
    start = _initial(initial)
    fleet = None if size_prior is None else named_size_prior(size_prior)
    observation = observe(keypoints, confidence, box, covariance, camera, shape_prior, options)
    model = prepare(shape_prior, fleet, options.basis_vectors)

    started = perf_counter()
    pose = adjust_pose(observation, camera, model, plane, start, options)
    posed = perf_counter()
    problem = build_problem(observation, camera, model, plane, options)
    scene = Scene(observation, camera, model, plane, problem.box, options)
    shape = adjust_shape(scene, problem, pose)
    shaped = perf_counter()
    uncertainty, graph = _final_graph(scene, problem, shape)
    milliseconds = {"pose": (posed - started) * 1e3, "shape": (shaped - posed) * 1e3}
    return build_result(scene, pose, shape, uncertainty, graph, milliseconds)


def _final_graph(
    scene: Scene, problem: PoseProblem, shape: ShapeEstimate
) -> tuple[Covariances | None, tuple[GraphFactor, ...]]:
    """Covariances and structure of the joint graph at the result, whichever stage came last."""
    vehicle = VehicleGraph(scene, shape.pose, pose_free=True)
    values = vehicle.values(shape.pose, shape.coefficients, shape.offsets)
    weights = graph_weights(problem, shape.weights, shape.visibility)
    terms = vehicle.terms(weights, shape.box_weights)
    graph = graph_factors(vehicle, terms, weights) if scene.options.keep_history else ()
    return covariances(vehicle, build(terms), values), graph


def ground_plane(ground: Ground | float | None) -> Ground | None:
    """The plane, or that of a level camera at a height in metres.

    Raises:
        InvalidInputError: It is neither a plane nor a positive number.
    """
    if ground is None or isinstance(ground, Ground):
        return ground
    return Ground.level(float(as_finite("ground", ground, (), "Give a `Ground`, or the camera's height in metres.")))


def _initial(initial: Box3D | float | None) -> Box3D | float | None:
    if initial is None or isinstance(initial, Box3D):
        return initial
    return float(as_finite("initial", initial, (), "Give a `Box3D`, or a guess of rotation_y in radians."))


def observe(
    keypoints: ArrayLike,
    confidence: ArrayLike | None,
    box: ArrayLike | None,
    covariance: ArrayLike | None,
    camera: Camera,
    prior: ShapePrior,
    options: Options,
) -> Observation:
    """The observation that is solved from: checked against the prior's category, and freed of lens distortion.

    Raises:
        InvalidInputError: An array has the wrong shape or values.
    """
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
