"""The problem of one vehicle in one image: noise models, confidences, and the terms that apply."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from factors.box import BoxRows
from factors.keypoint_rows import KeypointRows, whiteners
from fgrecon.core.arrays import Array
from fgrecon.core.camera import Camera, Ground
from fgrecon.core.errors import DegenerateProblemError
from fgrecon.core.evidence import Evidence as SensorEvidence
from fgrecon.core.observation import Observation
from fgrecon.core.options import BoxModel, BoxOptions, KeypointOptions, Options
from fgrecon.core.robust import Evidence
from fgrecon.solve.proposals.mask_term import mask_terms
from fgrecon.solve.proposals.point_term import POINTS_NAME, PointTerm, point_terms
from fgrecon.solve.proposals.search import PoseEnergy
from fgrecon.solve.proposals.search_settings import SETTINGS
from fgrecon.solve.proposals.terms import BoxTerm, DirectionTerm, GroundTerm, KeypointTerm, SizeTerm
from fgrecon.solve.vehicle.model import LinearPoints, VehicleModel


@dataclass(frozen=True)
class Problem:
    """One vehicle in one image, to be solved: what is given, and the energy that it makes of a pose.

    Attributes:
        observation: Undistorted keypoints.
        camera: The camera, whose distortion is not used.
        model: The prepared prior.
        ground: Ground plane, or None.
        options: Settings.
        energy: The terms that apply, for many poses at once.
        assumed: Whether no detector has said how far the keypoints are off.
    """

    observation: Observation
    camera: Camera
    model: VehicleModel
    ground: Ground | None
    options: Options
    energy: PoseEnergy
    assumed: bool = False

    @classmethod
    def of(
        cls, observation: Observation, camera: Camera, model: VehicleModel, ground: Ground | None, options: Options
    ) -> Problem:
        """The problem of an observation.

        Raises:
            DegenerateProblemError: Too few points, all in one place or line, or without any weight.
        """
        points = point_terms(observation, camera, model) if observation.evidence else ()
        points = tuple(one for one in points if one.name not in options.disabled_terms)
        masked = observation.evidence and "mask" not in options.disabled_terms
        masks = mask_terms(observation, camera, model) if masked else ()
        if not (points or masks) or observation.box is None:
            _check_points(observation)
        energy = replace(_energy(observation, camera, model, ground, options, points), masks=masks)
        return cls(observation, camera, model, ground, options, energy, assumed=observation.covariance is None)

    @property
    def common_factor(self) -> float:
        """By how much a detector's errors, which go together, make its keypoints say less; 1 for a person's."""
        return 1.0 if self.observation.covariance is None else self.options.keypoints.common_factor

    @property
    def box_common_factor(self) -> float:
        """The same of the 2D box: a projected 3D box comes from no detector, and counts whole."""
        return 1.0 if self.options.box.model is BoxModel.CUBOID else self.common_factor

    def showing(self, observation: Observation) -> Problem:
        """The same of another observation of the vehicle, such as the flipped one.

        Raises:
            DegenerateProblemError: As `of`.
        """
        other = Problem.of(observation, self.camera, self.model, self.ground, self.options)
        return replace(other, assumed=self.assumed)

    def sensing(self, evidence: Sequence[SensorEvidence]) -> Problem:
        """The same with other evidence of sensors.

        Raises:
            DegenerateProblemError: As `of`.
        """
        return self.showing(replace(self.observation, evidence=tuple(evidence)))

    def as_vehicle(self, model: VehicleModel) -> Problem:
        """The same of a vehicle of another model, which shares all that is about the image alone.

        Raises:
            DegenerateProblemError: As `of`.
        """
        if self.energy.points or self.energy.masks:
            return Problem.of(self.observation, self.camera, model, self.ground, self.options)
        keypoints, box = self.energy.keypoints, self.energy.box
        points = model.box_points(self.options.box.model)
        energy = replace(
            self.energy,
            keypoints=replace(keypoints, mean=model.prior.mean, basis=model.prior.basis),
            visibility=model.visibility.lookup,
            box=None if box is None else _box_about(points, self.camera, box.rows),
            size=_size_term(model, self.options),
        )
        return replace(self, model=model, energy=energy)

    def on(self, ground: Ground | None) -> Problem:
        """The same on another ground, or on none."""
        term = None if ground is None or "ground" in self.options.disabled_terms else GroundTerm(ground)
        return replace(self, ground=ground, energy=replace(self.energy, ground=term))


def _check_points(observation: Observation) -> None:
    """Refuse observations that cannot determine a pose."""
    points = observation.keypoints[observation.measured & (observation.confidence > 0)]
    least = SETTINGS.least_keypoints
    if not observation.measured.any():
        raise DegenerateProblemError("keypoints", "no measured point", f"Give at least {least} keypoints.")
    if not len(points):
        raise DegenerateProblemError("confidence", "all zero", "Give at least three points a confidence above zero.")
    if len(points) < least:
        fix = f"Give at least {least} keypoints with a confidence above zero."
        raise DegenerateProblemError("keypoints", f"{len(points)} usable points", fix)
    centred = points - points.sum(axis=0) / len(points)
    (along, both), (_, across) = (centred.T @ centred).tolist()
    middle, apart = (along + across) / 2.0, math.hypot((along - across) / 2.0, both)  # squares of the spreads
    if middle - apart < 1e-6 * max(middle + apart, 1.0):
        raise DegenerateProblemError("keypoints", "all points on one line", "Give keypoints that span an area.")


def keypoint_covariances(observation: Observation, options: KeypointOptions) -> Array:
    """(K, 2, 2) covariance of each keypoint in square pixels.

    Where the detector gives a covariance, a pixel's and a tenth of the general noise is added for what no shape of the
    prior can meet; else the noise is isotropic with the general standard deviation.
    """
    spread = options.sigma_relative * observation.extent
    if observation.covariance is None:
        covariance, added = np.zeros((len(observation.keypoints), 2, 2)), spread**2 + options.sigma_pixels**2
    else:
        added = SETTINGS.model_noise_share * spread**2 + options.sigma_pixels**2
        covariance = observation.covariance.copy()
    covariance[:, 0, 0] += added
    covariance[:, 1, 1] += added
    return covariance


def _energy(
    observation: Observation,
    camera: Camera,
    model: VehicleModel,
    ground: Ground | None,
    options: Options,
    points: tuple[PointTerm, ...],
) -> PoseEnergy:
    extent = observation.extent
    if extent < 1.0:
        raise DegenerateProblemError("keypoints", f"extent {extent:.3g} px", "Give keypoints that are not all one.")
    covariance = keypoint_covariances(observation, options.keypoints)
    evidence, off = _evidence(observation, covariance), options.disabled_terms
    measured = any(one.name == POINTS_NAME for one in points)
    share = SETTINGS.points.box_sigma_share if measured and options.box.model is BoxModel.CUBOID else 1.0
    box = None if "box" in off else box_term(observation, camera, model, options.box, share)
    if observation.covariance is None:  # isotropic and all alike, which needs no linear algebra
        whitener = np.full((len(covariance), 3), 1.0 / np.sqrt(covariance[0, 0, 0]))
        whitener[:, 1] = 0.0
    else:
        whitener = whiteners(covariance)
    keypoints = KeypointTerm(
        mean=model.prior.mean,
        basis=model.prior.basis,
        matrix=camera.matrix,
        rows=KeypointRows(np.where(observation.measured[:, None], observation.keypoints, 0.0), whitener),
        evidence=evidence,
        strategy=options.strategy,
    )
    return PoseEnergy(
        keypoints=keypoints,
        visibility=model.visibility.lookup,
        box=box,
        size=_size_term(model, options),
        ground=None if ground is None or "ground" in off else GroundTerm(ground),
        direction=None if observation.azimuth is None else DirectionTerm(observation.azimuth),
        points=points,
    )


def _size_term(model: VehicleModel, options: Options) -> SizeTerm | None:
    if model.size is None or "dimensions" in options.disabled_terms:
        return None
    return SizeTerm(model.dimension_mean, model.dimension_basis, model.size)


def box_term(
    observation: Observation, camera: Camera, model: VehicleModel, options: BoxOptions, sigma_share: float = 1.0
) -> BoxTerm | None:
    """The 2D box as evidence, with a share of its standard deviation; None where there is no box or it counts not."""
    if observation.box is None or options.model is BoxModel.OFF:
        return None
    points = model.box_points(options.model)
    extent = observation.extent
    sigma = sigma_share * float(np.hypot(options.sigma_relative * extent, options.sigma_pixels))
    wrong = SETTINGS.edge_wrong_probability
    outlier = wrong / (1.0 - wrong) * np.sqrt(2.0 * np.pi) * sigma / extent
    used = np.ones(4, dtype=bool)
    if camera.image_size is not None:
        width, height = camera.image_size
        used[:2] = observation.box[:2] > SETTINGS.border_pixels
        used[2:] = observation.box[2:] < np.array([width, height]) - 1.0 - SETTINGS.border_pixels
    edges = observation.box
    if options.model is BoxModel.DETECTED:
        edges = edges - np.array(options.edges) * np.tile(edges[2:] - edges[:2], 2)
    rows = BoxRows(edges, used, sigma, float(outlier), SETTINGS.box_softness_sigmas * sigma)
    return _box_about(points, camera, rows)


def _box_about(points: LinearPoints, camera: Camera, rows: BoxRows) -> BoxTerm:
    return BoxTerm(points.mean, points.basis, camera.matrix, replace(rows, inside=rows.softness * points.inside))


def _evidence(observation: Observation, covariance: Array) -> Evidence:
    right = np.minimum(
        np.maximum(observation.right, 1.0 - SETTINGS.most_right_probability), SETTINGS.most_right_probability
    )
    box = observation.box
    area = observation.extent**2 if box is None else (box[2] - box[0]) * (box[3] - box[1])
    outlier = np.minimum(2.0 * np.pi * np.sqrt(np.linalg.det(covariance)) / area, SETTINGS.most_outlier_density)
    return Evidence(np.where(observation.measured, right, 0.0), outlier, observation.measured)
