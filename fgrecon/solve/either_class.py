"""How unsure a vehicle is that may be a car or a van: one covariance for both, by matching moments.

A car and a van that look alike differ in size, and so in distance. The graph's covariances are those of one size; that
the vehicle may be of the other class is not in them. So from where a result is, its heading kept, the vehicle is solved
as either. What lies between the two ends, by how probable each is, is added to the covariances (the law of total
variance); the result stays where it is.

Frames of one vehicle err alike: the log odds of a class that they give are averaged and not added up, just as all of
them count for the size as one (`ShapeOptions.common_error`).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

import gtsam
import numpy as np

from fgrecon.core.arrays import Array
from fgrecon.core.errors import FgreconError
from fgrecon.core.reconstruction import Reconstruction
from fgrecon.solve.fitted_class import FittedClass, is_open, log_odds_of_van, odds_before_image
from fgrecon.solve.graph.graph import EXTRA, Graph, GraphObservation, State
from fgrecon.solve.graph.mode_selection import is_flipped
from fgrecon.solve.graph.observation_part import Weights
from fgrecon.solve.graph.optimise import Optimum, optimise
from fgrecon.solve.graph.vehicle_part import counts_classes
from fgrecon.solve.inputs import SolveSetup
from fgrecon.solve.proposals.problem import Problem
from fgrecon.solve.solve_settings import SCENE


@dataclass(frozen=True)
class EitherClass:
    """What a van instead of a car changes, and how probable that is."""

    log_odds: float  # of a van against a car
    turn: Array  # (3,) rotation of the van against the car, radians, in the vehicle's own frame
    place: Array  # (3,) of the car's origin, metres, in the camera's frame
    move: Array  # (3,) from there to the van's
    coefficients: Array  # (N,) from the shape of the car to that of the van
    keypoints: Array  # (K, 3) the same in metres, in the vehicle's own frame
    size: Array  # (3,) and of length, width and height
    car_size: Array  # (3,) these of the car
    car_more: float  # by how much the sizes of cars spread more than covariances count, in shares of `size`, squared
    van_more: float  # and those of vans

    def added_to(self, result: Reconstruction, log_odds: float) -> Reconstruction:
        """A result with covariances for both classes.

        Args:
            log_odds: Of a van against a car, by all that is known.
        """
        known = result.uncertainty
        if (
            known.pose_covariance is None
            or known.size_covariance is None
            or known.coefficients_covariance is None
            or known.keypoint_covariance is None
            or len(known.coefficients_covariance) != len(self.coefficients)  # of a lorry by now
        ):
            return result
        van, at = _probability(log_odds), self._at(result.shape.box_size)
        more = (1.0 - van) * self.car_more + van * self.van_more
        spread = (1.0 - van) * at**2 + van * (1.0 - at) ** 2 + max(more, 0.0)
        pose = np.concatenate([self.turn, result.camera_T_object[:3, :3].T @ self._moved(result.location)])
        shifts = self.keypoints[:, :, None] * self.keypoints[:, None, :]
        uncertainty = replace(
            known,
            pose_covariance=known.pose_covariance + spread * np.outer(pose, pose),
            coefficients_covariance=known.coefficients_covariance
            + spread * np.outer(self.coefficients, self.coefficients),
            keypoint_covariance=known.keypoint_covariance + spread * shifts,
            size_covariance=known.size_covariance + spread * np.outer(self.size, self.size),
        )
        return replace(result, uncertainty=uncertainty)

    def lower(self, location: Array, size: Array, down: Array, log_odds: float) -> tuple[float, float]:
        """By how much lower than solved a vehicle stands whose class is open, metres: mean and standard deviation.

        Args:
            location: (3,) where it was solved, metres, in the camera's frame.
            size: (3,) with which it was.
            down: (3,) what is down there.
            log_odds: Of a van against a car, by all that is known.
        """
        van, way = _probability(log_odds), float(down @ self._moved(location))
        return (van - self._at(size)) * way, math.sqrt(van * (1.0 - van)) * abs(way)

    def _at(self, size: Array) -> float:
        """Where a size (3,) is on the way from the car, 0, to the van, 1."""
        along = float((size - self.car_size) @ self.size) / max(float(self.size @ self.size), 1e-12)
        return min(max(along, 0.0), 1.0)

    def _moved(self, location: Array) -> Array:
        """(3,) the move of a vehicle that has come to a place (3,) since, metres: along the ray there, and in scale."""
        before, now = float(np.linalg.norm(self.place)), float(np.linalg.norm(location))
        along = float(self.move @ self.place) / before
        across = self.move - along * self.place / before
        moved: Array = now / before * (along * location / now + across)
        return moved


def either_class(
    problem: Problem,
    camera_T_object: Array,
    coefficients: Array,
    setup: SolveSetup,
    classes: Mapping[str, float] | None,
    alone: Optimum | None = None,
) -> EitherClass | None:
    """What a van instead of a car changes; None where the class is not open, or nothing tells.

    It is open where somebody leaves it open, or nobody says it and the fleet's traffic has more than its cars. Where
    measured points say how large a vehicle is its class does not matter.

    Args:
        problem: What was solved.
        camera_T_object: (4, 4) the result's pose.
        coefficients: (N,) its shape.
        setup: What holds for all vehicles of the call.
        classes: Probability of each class as far as somebody says it; None where nobody does.
        alone: Where the vehicle by itself ended, solved as one of its fleet, which is a car then; None to solve it so.
    """
    observation, options = problem.observation, problem.options
    with_vans = setup.fleet is not None and setup.fleet.traffic is not None
    doubted = with_vans if classes is None else is_open(classes)
    larger = problem.model.size is not None and bool(problem.model.size.larger)
    usual = doubted and counts_classes(options) and not larger and not setup.is_measured(observation, problem.camera)
    if not usual or not np.isfinite(camera_T_object).all():
        return None
    if alone is not None and classes is None:
        car = _Solved.of(alone, problem)
    else:
        car = _solved_as("car", problem, camera_T_object, coefficients, setup)
    van = None if car is None else _solved_as("van", problem, camera_T_object, coefficients, setup)
    if car is None or van is None:
        return None
    if classes is not None and any(isinstance(one, FittedClass) for one in observation.evidence):
        log_odds = math.log(classes["van"] / classes["car"])  # with its image already
    else:
        log_odds = log_odds_of_van(sum(odds_before_image(classes)), car.energy, van.energy)
    return _between(car, van, log_odds, problem, setup)


def with_either_class(result: Reconstruction, problem: Problem, setup: SolveSetup, alone: Optimum) -> Reconstruction:
    """The result of a vehicle in one image, with covariances for both classes where its class is open.

    Args:
        problem: What was solved.
        setup: What holds for all vehicles of the call.
        alone: Where the vehicle by itself ended.
    """
    if result.uncertainty.pose_covariance is None:
        return result
    classes = setup.classes_of([problem.observation])
    either = either_class(problem, result.camera_T_object, result.shape.coefficients, setup, classes, alone)
    return result if either is None else either.added_to(result, either.log_odds)


def mean_log_odds(frames: Iterable[EitherClass | None]) -> float:
    """Log odds of a van by frames of one vehicle; 0 where none says anything."""
    known = [one.log_odds for one in frames if one is not None]
    return sum(known) / len(known) if known else 0.0


def _probability(log_odds: float) -> float:
    return 1.0 / (1.0 + math.exp(-log_odds))


@dataclass(frozen=True)
class _Solved:
    """A vehicle as one of a class."""

    pose: gtsam.Pose3
    keypoints: Array  # (K, 3) in its own frame
    size: Array  # (3,)
    energy: float  # nats, of all but factors of the caller's own

    @classmethod
    def of(cls, end: Optimum, problem: Problem) -> _Solved | None:
        """Where a solve of it alone ended; None where it gave up."""
        if end.failure is not None:
            return None
        prior = problem.model.prior
        (shape,) = end.state.shapes.values()
        keypoints = prior.keypoints(*shape)
        energy = end.energy - end.energies.get(EXTRA, 0.0)
        return cls(end.state.poses[0], keypoints, prior.category.box_size(keypoints), energy)


def _solved_as(
    name: str, problem: Problem, camera_T_object: Array, coefficients: Array, setup: SolveSetup
) -> _Solved | None:
    """A vehicle as one of a class, from a pose and shape of another size; None where it has no pose."""
    model = setup.model_as(name)
    height = problem.model.prior.box_size(coefficients)[2]
    start = camera_T_object.copy()
    start[:3, 3] *= model.dimension_mean[2] / max(height, 1e-3)  # where it looks as high
    try:
        made = problem.as_vehicle(model)
        count = model.prior.category.size
        weights = Weights(np.ones(count), np.ones(count), np.ones(4), float(start[2, 3]))
        shape = coefficients, np.zeros((count, 3))
        state = State([gtsam.Pose3(start)], {0: shape}, [weights])
        graph = Graph([GraphObservation(made)], state, pose_free=True)
        optimum = optimise(graph, state, steady=SCENE.single_visibility_step)
    except FgreconError:
        return None
    return _Solved.of(optimum, made)


def _between(car: _Solved, van: _Solved, log_odds: float, problem: Problem, setup: SolveSetup) -> EitherClass:
    """What lies between both."""
    rotation, apart = car.pose.rotation().between(van.pose.rotation()), van.keypoints - car.keypoints
    size = van.size - car.size
    turned = is_flipped(car.pose.matrix(), van.pose.matrix())  # which the facing says
    return EitherClass(
        log_odds,
        np.zeros(3) if turned else gtsam.Rot3.Logmap(rotation),
        car.pose.translation(),
        van.pose.translation() - car.pose.translation(),
        problem.model.by_keypoints @ apart.ravel(),
        apart,
        size,
        car.size,
        *(_spreads_more(name, size, problem, setup) for name in ("car", "van")),
    )


def _spreads_more(name: str, size: Array, problem: Problem, setup: SolveSetup) -> float:
    """By how much the sizes of a class spread more along the way (3,) from car to van than those of the model do.

    In shares of the way, squared.
    """
    counted, own = problem.model.size, setup.model_as(name).size
    if counted is None or own is None:
        return 0.0
    way = max(float(size @ size), 1e-12)
    return float(size @ (own.own_spread - counted.own_spread) @ size) / way**2
