"""Keypoints of a vehicle whose 3D box is known in every image, by the factor graph.

    image t: reprojection of what a network found, robust --- X(0,t) --- labelled box
                        |
                    L(0), O(0) --- N(0, I) given the box's size, offsets, symmetry, rectangular faces

Where the box is and which way it faces is known, so a network's points are evidence under the right facing alone: what
contradicts it is outvoted by the box and by the other images. The shape is free within what the size leaves open; the
images of a vehicle share it. Labels are the projections of that shape, hidden keypoints as well.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import gtsam
import numpy as np

from factors import X
from fgrecon.calibration.labelled_boxes import Reason
from fgrecon.core.arrays import Array
from fgrecon.core.box3d import Box3D
from fgrecon.core.camera import Camera
from fgrecon.core.errors import DegenerateProblemError, InvalidInputError
from fgrecon.core.observation import Observation
from fgrecon.core.options import Options, ShapeOptions
from fgrecon.core.shape_prior import ShapePrior
from fgrecon.core.size_prior import SizePrior
from fgrecon.solve.graph.covariance import marginals_of, projected_covariances
from fgrecon.solve.graph.graph import GraphObservation
from fgrecon.solve.graph.multi_start import MultiStartResult, minimise_from_proposals
from fgrecon.solve.inputs import SolveSetup, observe
from fgrecon.solve.proposals.pose_search import PoseEstimate
from fgrecon.solve.proposals.problem import Problem
from fgrecon.solve.proposals.starts import from_box3d
from fgrecon.solve.result import results
from fgrecon.solve.vehicle.model import prepare
from fgrecon_research.annotation.annotation import Fit


@dataclass(frozen=True)
class KnownBoxSettings:
    """How exactly boxes are labelled, one sigma."""

    turn_sigma: float = float(np.deg2rad(1.5))  # yaw, roll and pitch, radians
    shift_sigma: float = 0.06  # location per axis near the camera, metres
    depth_share: float = 0.004  # added to that of the depth, as a share of the distance
    size_share: float = 0.03  # length, width and height, as a share of each
    common_error: float = 0.3  # as in `fgrecon.core.options.ShapeOptions`


SETTINGS = KnownBoxSettings()


@dataclass(frozen=True)
class BoxedView:
    """One image of a vehicle."""

    observation: Observation  # what a network found, with the 2D box
    camera: Camera
    box: Box3D  # the 3D box in the camera's frame, with its size


def fit_known_boxes(views: Sequence[BoxedView], prior: ShapePrior) -> list[Fit | Reason]:
    """The shape of a vehicle of known boxes, and its poses within what the boxes leave open.

    Raises:
        InvalidInputError: There is no image, a box has no size, or an observation is of another category.
    """
    if not views or any(view.box.size is None for view in views):
        raise InvalidInputError("views", f"{len(views)} images", "Give at least one, each with the size of its box.")
    sizes = np.array([view.box.size for view in views], dtype=np.float64)
    size = np.median(sizes, axis=0)
    model = prepare(prior, SizePrior("of the box", size, SETTINGS.size_share * size))
    options = Options(box="off", shape=ShapeOptions(common_error=SETTINGS.common_error), keep_history=False)
    parts: list[GraphObservation] = []
    starts: list[PoseEstimate] = []
    extra: list[gtsam.NonlinearFactor] = []
    for number, view in enumerate(views):
        observation, _ = observe(view.observation, view.camera, SolveSetup(options, prior, model))
        try:
            problem = Problem.of(observation, view.camera, model, None, options)
        except DegenerateProblemError:
            continue
        start = _start(problem, view.box)
        parts.append(GraphObservation(problem, image=number))
        starts.append(start)
        extra.append(_labelled(start.camera_T_object, X(0, number)))
    found: list[Fit | Reason] = [Reason.FEW_POINTS] * len(views)
    if parts:
        adjusted = minimise_from_proposals(parts, starts, extra)
        solved = results(parts, starts, adjusted, {}, extra)
        for one, result, covariance in zip(parts, solved, _covariances(adjusted), strict=True):
            found[one.image] = Reason.NO_MINIMUM if covariance is None else Fit.of(result, covariance, model.prior)
    return found


def _covariances(adjusted: MultiStartResult) -> list[Array | None]:
    """(K, 2, 2) of the projected keypoints in each image; None where the graph has no minimum that determines them."""
    graph, optimum = adjusted.graph, adjusted.optimum
    values = graph.values(optimum.state)
    marginals = (
        None if optimum.failure is not None else marginals_of(graph, values, optimum.state.weights, as_assumed=True)
    )
    return [None if marginals is None else projected_covariances(p, values, marginals) for p in graph.observations]


def _start(problem: Problem, box: Box3D) -> PoseEstimate:
    """The labelled box as the one proposal."""
    start = from_box3d(replace(box, size=None), problem.model, None)
    pose = start.matrices()[0]
    total, weights = problem.energy.evaluate(start)
    return PoseEstimate(
        camera_T_object=pose,
        coefficients=start.coefficients[0],
        weights=weights[0],
        visibility=problem.energy.visibility(pose[None])[0],
        energy=float(total.energy[0]),
        alternatives=(),
        history=(),
    )


def _labelled(pose: Array, key: int) -> gtsam.NonlinearFactor:
    """The labelled pose as a prior; its spread along the line of sight is larger than across."""
    sight = pose[:3, 3] / np.linalg.norm(pose[:3, 3])
    depth = SETTINGS.depth_share * float(np.linalg.norm(pose[:3, 3]))
    shift = SETTINGS.shift_sigma**2 * np.eye(3) + depth**2 * np.outer(sight, sight)
    rotation = pose[:3, :3]
    covariance = np.zeros((6, 6))
    covariance[:3, :3] = SETTINGS.turn_sigma**2 * np.eye(3)
    covariance[3:, 3:] = rotation.T @ shift @ rotation  # GTSAM's increments are in the object's frame
    noise = gtsam.noiseModel.Gaussian.Covariance((covariance + covariance.T) / 2)
    return gtsam.PriorFactorPose3(key, gtsam.Pose3(pose), noise)
