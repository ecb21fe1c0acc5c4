"""Headings of an image's vehicles: by their detector, by one another, and by the traffic where it is given.

    right(0) ----- alike? ----- right(1) ----- alike? ----- right(2)
        |                           |                           |
    detector, traffic           detector, traffic           detector, traffic

Vehicles in one row or lane face alike, those some metres beside it often the other way: by how far apart they are
across their headings, a weak factor between any two that are near each other. What directions say beside which way a
vehicle faces stays as it is. A network that takes a rear for a front often does so with all its keypoints: where these
lead to the less probable side, they are flipped as a whole.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from fgrecon.core.arrays import Array
from fgrecon.core.box3d import Box3D
from fgrecon.core.camera import Camera
from fgrecon.core.detection import half_around, pose_facing_probability
from fgrecon.core.errors import DegenerateProblemError
from fgrecon.core.geometry import view_azimuth, yaw_rotation
from fgrecon.core.half_turn import flipped_directions, flipped_observation
from fgrecon.core.heading_coupling import heading_odds, mean_field, traffic_directions
from fgrecon.core.metrics import wrap_angle
from fgrecon.core.observation import Observation
from fgrecon.core.options import Options
from fgrecon.core.shape_prior import ShapePrior
from fgrecon.solve.inputs import SolveSetup
from fgrecon.solve.proposals.pose_search import PoseEstimate, search_pose
from fgrecon.solve.proposals.problem import Problem
from fgrecon.solve.solve_settings import FACING
from fgrecon.solve.vehicle.model import VehicleModel


def couple_facings(
    observations: Sequence[Observation], camera: Camera, prior: ShapePrior, options: Options
) -> list[Observation]:
    """The observations of an image with directions that know of one another and of the traffic.

    Those of which nothing but the detector says which way they face stay as they are, and so do those without
    directions.

    Args:
        observations: Without lens distortion.
        camera: The camera that took the image.
        prior: Its height says about how far away a vehicle is.
        options: Which side the traffic keeps to.
    """
    coupled = list(observations)
    if len(coupled) < 2 and options.traffic is None:
        return coupled
    found = {i: side for i, one in enumerate(coupled) if (side := _Side.of(one, camera, prior)) is not None}
    sides = list(found.values())
    own = np.array([side.odds for side in sides])
    if options.traffic is not None:
        own += [side.along(traffic_directions(options.traffic, side.place, len(side.ahead))) for side in sides]
    headings, places = np.array([side.heading for side in sides]), np.array([side.place for side in sides])
    between = FACING.neighbour_share * heading_odds(headings, places.reshape(-1, 3), FACING.neighbour_distance_m)
    right = (1.0 + mean_field(own, between)) / 2.0
    for row, (i, side) in enumerate(found.items()):
        if options.traffic is not None or between[row].any():
            coupled[i] = coupled[i].with_directions(_either_way(side.ahead, right[row]))
    return coupled


def single_pose(
    observation: Observation,
    camera: Camera,
    model: VehicleModel,
    setup: SolveSetup,
    initial: Box3D | float | None = None,
) -> tuple[Problem, PoseEstimate]:
    """The pose stage of an observation whose neighbours are not known; see `estimate_pose`.

    Args:
        observation: Without lens distortion.
        camera: The camera that took the image.
        model: Of the vehicle, by what its observations say (`SolveSetup.model_of`).
        setup: What holds for all vehicles of the call.
        initial: As `search_pose` takes it; where it is given, which way the vehicle faces is said already.

    Raises:
        DegenerateProblemError: No pose is found.
    """
    coupled = observation
    if initial is None:
        (coupled,) = couple_facings([observation], camera, setup.prior, setup.options)
    problem = Problem.of(coupled, camera, model, setup.ground, setup.options)
    start = search_pose(problem, initial)
    return (problem, start) if coupled is observation else _agreeing(problem, start, observation)


def estimate_pose(problem: Problem, detected: Observation) -> tuple[Problem, PoseEstimate]:
    """The pose stage of an observation whose directions know the rest, its keypoints flipped if need be.

    Args:
        problem: Of the observation.
        detected: It as its detector gave it.

    Raises:
        DegenerateProblemError: No pose is found.
    """
    return _agreeing(problem, search_pose(problem), detected)


def _agreeing(problem: Problem, start: PoseEstimate, detected: Observation) -> tuple[Problem, PoseEstimate]:
    """The problem and its pose, or those of flipped keypoints where only these agree with the directions of others."""
    observation = problem.observation
    azimuth = observation.azimuth
    if azimuth is None or azimuth is detected.azimuth:
        return problem, start
    if pose_facing_probability(azimuth, start.camera_T_object) >= 0.5:
        return problem, start
    try:
        flipped = problem.showing(replace(flipped_observation(observation, problem.model.prior), azimuth=azimuth))
        again = search_pose(flipped)
    except DegenerateProblemError:  # too few keypoints have a partner on the other side
        return problem, start
    agrees = pose_facing_probability(azimuth, again.camera_T_object) >= 0.5
    return (flipped, again) if agrees else (problem, start)


def estimate_pose_facing(
    problem: Problem, heading: float, right: float, place: Array
) -> tuple[Problem, PoseEstimate] | None:
    """The pose stage of an observation of which others say that it faces elsewhere; what else it says stays.

    Args:
        problem: Of the observation.
        heading: `rotation_y` that they say, radians.
        right: Probability of its half of all.
        place: (3,) about where the vehicle is, metres.

    Returns:
        The problem and its pose; None without directions, or where no pose is found.
    """
    observation = problem.observation
    if observation.azimuth is None:
        return None
    towards = float(view_azimuth(yaw_rotation(heading), place))
    ahead = half_around(towards, len(observation.azimuth)) * (
        observation.azimuth + flipped_directions(observation.azimuth)
    )
    other = observation.with_directions(_either_way(ahead / ahead.sum(), right))
    try:
        return estimate_pose(problem.showing(other), observation)
    except DegenerateProblemError:
        return None


def _either_way(ahead: Array, right: float) -> Array:
    """(A,) directions that are these (A,) with a probability, and turned by half otherwise."""
    return right * ahead + (1.0 - right) * flipped_directions(ahead)


@dataclass(frozen=True)
class _Side:
    """What a detector's directions say."""

    ahead: Array  # (A,) probability of each direction of the more probable half
    probability: float  # of that half
    place: Array  # (3,) about where the vehicle is, metres
    heading: float  # `rotation_y` by that half

    @classmethod
    def of(cls, observation: Observation, camera: Camera, prior: ShapePrior) -> _Side | None:
        """Of an observation; None where it has no directions, or nothing is measured."""
        place = _place(observation, camera, prior)
        if observation.azimuth is None or place is None:
            return None
        bins = len(observation.azimuth)
        azimuths = 2.0 * np.pi * np.arange(bins) / bins
        near = half_around(azimuths[int(observation.azimuth.argmax())], bins)
        probability = float(near @ observation.azimuth)
        ahead = near * observation.azimuth / probability
        azimuth = float(np.angle(ahead @ np.exp(1j * azimuths)))
        # The direction changes with the heading one to one: one heading and its direction tell all others.
        first, second = view_azimuth(yaw_rotation(np.array([0.0, 0.1])), np.broadcast_to(place, (2, 3)))
        heading = np.sign(wrap_angle(second - first)) * (azimuth - first)
        return cls(ahead, probability, place, float(wrap_angle(heading)))

    @property
    def odds(self) -> float:
        """Logarithm of the odds that the more probable half is the right one."""
        least = FACING.detector_error_probability
        p = min(max(self.probability, least), 1.0 - least)
        return float(np.log(p / (1.0 - p)))

    def along(self, directions: Array) -> float:
        """Logarithm of the odds by directions (A,) that something else says."""
        return float(np.log(self.ahead @ directions) - np.log(flipped_directions(self.ahead) @ directions))


def _place(observation: Observation, camera: Camera, prior: ShapePrior) -> Array | None:
    """(3,) about where the vehicle is, metres, by its height in the image; None where nothing is measured."""
    points = observation.keypoints[observation.measured]
    if observation.box is None and len(points) < 2:
        return None
    corners = (
        np.array([points.min(axis=0), points.max(axis=0)]) if observation.box is None else observation.box.reshape(2, 2)
    )
    _, _, height = np.tensordot(prior.category.dimension_operator, prior.mean, axes=2)
    depth = float(height) * float(camera.matrix[1, 1]) / max(float(corners[1, 1] - corners[0, 1]), 1.0)
    return depth * camera.rays(corners.mean(axis=0)[None])[0]
