"""From an observation to the pose search's problem: noise models, confidences, the terms that apply."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.camera import Camera, Ground
from fgrecon.core.errors import DegenerateProblemError
from fgrecon.core.observation import Observation
from fgrecon.core.options import BoxModel, Options
from fgrecon.core.robust import Evidence
from fgrecon.solve.proposals.search import PoseProblem
from fgrecon.solve.proposals.terms import BoxTerm, GroundTerm, KeypointTerm, SizeTerm
from fgrecon.solve.vehicle.model import VehicleModel

__all__ = ["box_term", "build_problem", "keypoint_covariances"]

Array = NDArray[np.float64]

_SURE = 0.99  # no detector is surer than that
_BORDER = 2.0  # pixels from the image's border within which a box edge says nothing
_SOFT_CORNERS, _SOFT_OUTLINE = 0.5, 0.2  # softness per sigma: a box's corners leave creases, a dense outline hardly any
_FEW_POINTS = 8
_EDGE_WRONG = 0.1  # probability that a box edge is wrong


def keypoint_covariances(observation: Observation, options: Options) -> Array:
    """(K, 2, 2) covariance of each keypoint in square pixels.

    Where the detector gives a covariance, a pixel's and a tenth of the general noise is added for what no shape of the
    prior can meet; else the noise is isotropic with the general standard deviation.
    """
    identity = np.eye(2)
    spread = options.sigma_relative * observation.extent
    if observation.covariance is None:
        variance = spread**2 + options.sigma_pixels**2
        return np.broadcast_to(variance * identity, (len(observation.keypoints), 2, 2))
    return observation.covariance + (0.1 * spread**2 + options.sigma_pixels**2) * identity


def build_problem(
    observation: Observation, camera: Camera, model: VehicleModel, ground: Ground | None, options: Options
) -> PoseProblem:
    """The pose search's problem.

    Args:
        observation: Undistorted keypoints.
        camera: The camera, whose distortion is not used.
        model: The prepared prior.
        ground: Ground plane, or None.
        options: Settings.

    Raises:
        DegenerateProblemError: The keypoints lie in one place.
    """
    extent = observation.extent
    if extent < 1.0:
        raise DegenerateProblemError("keypoints", f"extent {extent:.3g} px", "Give keypoints that are not all one.")
    covariance = keypoint_covariances(observation, options)
    keypoints = KeypointTerm(
        mean=model.prior.mean,
        basis=model.prior.basis,
        matrix=camera.matrix,
        pixels=np.where(observation.measured[:, None], observation.keypoints, 0.0),
        whitener=np.linalg.inv(np.linalg.cholesky(covariance)),
        evidence=_evidence(observation, covariance, options),
        strategy=options.strategy,
    )
    off = options.disabled_terms
    size = None
    if model.size is not None and "dimensions" not in off:
        size = SizeTerm(model.dimension_mean, model.dimension_basis, model.size)
    return PoseProblem(
        keypoints=keypoints,
        visibility=model.visibility.lookup,
        box=None if "box" in off else box_term(observation, camera, model, options),
        size=size,
        ground=None if ground is None or "ground" in off else GroundTerm(ground),
    )


def box_term(observation: Observation, camera: Camera, model: VehicleModel, options: Options) -> BoxTerm | None:
    """The 2D box as evidence; None where there is no box or it is not to count."""
    if observation.box is None or options.box_model is BoxModel.OFF:
        return None
    points = model.box_points(options.box_model)
    extent = observation.extent
    sigma = float(np.hypot(options.box_sigma_relative * extent, options.box_sigma_pixels))
    outlier = _EDGE_WRONG / (1.0 - _EDGE_WRONG) * np.sqrt(2.0 * np.pi) * sigma / extent
    used = np.ones(4, dtype=bool)
    if camera.image_size is not None:
        width, height = camera.image_size
        used[:2] = observation.box[:2] > _BORDER
        used[2:] = observation.box[2:] < np.array([width, height]) - 1.0 - _BORDER
    softness = (_SOFT_CORNERS if len(points.mean) <= _FEW_POINTS else _SOFT_OUTLINE) * sigma
    return BoxTerm(points.mean, points.basis, camera.matrix, observation.box, used, sigma, float(outlier), softness)


def _evidence(observation: Observation, covariance: Array, options: Options) -> Evidence:
    squared = observation.confidence**2
    right = np.clip(squared / (squared + options.confidence_midpoint**2), 1.0 - _SURE, _SURE)
    box = observation.box
    area = observation.extent**2 if box is None else (box[2] - box[0]) * (box[3] - box[1])
    # Below 1, so that a wrong point never explains a keypoint better than a right one.
    outlier = np.minimum(2.0 * np.pi * np.sqrt(np.linalg.det(covariance)) / area, 0.5)
    return Evidence(np.where(observation.measured, right, 0.0), outlier, observation.measured)
