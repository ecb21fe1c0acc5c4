"""Covariance of a vehicle of unknown class: one for all classes that it may be of, by moment matching.

A car and a van that look alike differ in size, and so in distance. The graph's covariances are those of one size; that
the vehicle may be of another class is not in them. So from where a result is, its heading kept, the vehicle is solved
as one of each. What lies between these ends, by how probable each is, is added to the covariances (the law of total
variance); the result stays where it is.

Frames of one vehicle err alike: the log weights of classes that they give are averaged and not added up, just as all of
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
from fgrecon.solve.fitted_class import FittedClass, odds_before_image, open_classes, probabilities, with_energies
from fgrecon.solve.graph.graph import EXTRA, Graph, GraphObservation, State
from fgrecon.solve.graph.mode_selection import is_flipped
from fgrecon.solve.graph.observation_part import Weights
from fgrecon.solve.graph.optimise import Optimum, optimise
from fgrecon.solve.graph.vehicle_part import counts_classes
from fgrecon.solve.inputs import SolveSetup
from fgrecon.solve.proposals.problem import Problem
from fgrecon.solve.solve_settings import SCENE

_SWEEPS = 50  # over the ways from class to class, of which a size takes some of each


@dataclass(frozen=True)
class EitherClass:
    """What each other class instead of the first one changes (C - 1 ways), and how probable these C classes are."""

    weights: Mapping[str, float]  # log weight of each class, the first of which has none
    turns: Array  # (C - 1, 3) rotation against the first one, radians, in the vehicle's own frame
    place: Array  # (3,) of the origin of the first one, metres, in the camera's frame
    moves: Array  # (C - 1, 3) from there to those of the others
    coefficients: Array  # (C - 1, N) from the shape of the first one to those of the others
    keypoints: Array  # (C - 1, K, 3) the same in metres, in the vehicle's own frame
    sizes: Array  # (C - 1, 3) and of length, width and height
    first_size: Array  # (3,) these of the first one
    more: Array  # (C, C - 1) by how much the sizes of a class spread more along a way than is counted, in its squares

    def added_to(self, result: Reconstruction, weights: Mapping[str, float]) -> Reconstruction:
        """A result with covariances for all classes.

        Args:
            weights: Log weights of the classes, by all that is known.
        """
        known = result.uncertainty
        if (
            known.pose_covariance is None
            or known.size_covariance is None
            or known.coefficients_covariance is None
            or known.keypoint_covariance is None
            or len(known.coefficients_covariance) != self.coefficients.shape[1]  # of another shape by now
        ):
            return result
        first, others = self._probable(weights)
        at = self._at(result.shape.box_size)
        spread = first * np.outer(at, at)
        for way, probability in enumerate(others):
            off = np.eye(len(at))[way] - at
            spread = spread + probability * np.outer(off, off)
        of_first = others / max(float(others.sum()), 1e-300)  # of its own spread along each way
        more = first * of_first * self.more[0] + others * np.diag(self.more[1:])
        spread = spread + np.diag(np.maximum(more, 0.0))
        moved = [result.camera_T_object[:3, :3].T @ move for move in self._moved(result.location)]
        uncertainty = replace(
            known,
            pose_covariance=known.pose_covariance + _spread(spread, np.hstack([self.turns, moved])),
            coefficients_covariance=known.coefficients_covariance + _spread(spread, self.coefficients),
            keypoint_covariance=known.keypoint_covariance + _spread(spread, self.keypoints),
            size_covariance=known.size_covariance + _spread(spread, self.sizes),
        )
        return replace(result, uncertainty=uncertainty)

    def lower(self, location: Array, size: Array, down: Array, weights: Mapping[str, float]) -> tuple[float, float]:
        """By how much lower than solved a vehicle stands whose class is open, metres: mean and standard deviation.

        Args:
            location: (3,) where it was solved, metres, in the camera's frame.
            size: (3,) with which it was.
            down: (3,) what is down there.
            weights: Log weights of the classes, by all that is known.
        """
        _, others = self._probable(weights)
        ways = np.array([down @ move for move in self._moved(location)])
        most = max(float(np.abs(ways).max()), 1e-12)
        shares = ways / most
        spread = np.diag(others * (1.0 - others)) - np.outer(others, others) * (1.0 - np.eye(len(others)))
        return float((others - self._at(size)) @ ways), math.sqrt(max(float(shares @ spread @ shares), 0.0)) * most

    def _probable(self, weights: Mapping[str, float]) -> tuple[float, Array]:
        """Probability of the first class, and (C - 1,) of the others."""
        found = probabilities({name: weights.get(name, own) for name, own in self.weights.items()})
        first, *others = found.values()
        return first, np.array(others)

    def _at(self, size: Array) -> Array:
        """(C - 1,) where a size (3,) is on the ways from the first class, 0, to the others, 1."""
        at = np.zeros(len(self.sizes))
        for way in (*range(len(at)),) * (1 if len(at) == 1 else _SWEEPS):
            rest = at * (np.arange(len(at)) != way) @ self.sizes
            own = self.sizes[way]
            along = float((size - self.first_size - rest) @ own) / max(float(own @ own), 1e-12)
            at[way] = min(max(along, 0.0), 1.0)
        return at / max(float(at.sum()), 1.0)

    def _moved(self, location: Array) -> Array:
        """(C - 1, 3) the moves of a vehicle that has come to a place (3,) since, metres.

        Along the ray there, and in scale.
        """
        before, now = float(np.linalg.norm(self.place)), float(np.linalg.norm(location))
        along = np.array([[move @ self.place] for move in self.moves]) / before
        across = self.moves - along * self.place / before
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
    """What other classes instead of the first change; None where the class is not open, or nothing tells.

    It is open where somebody leaves it open, or nobody says it and the fleet's traffic has more than one. Where
    measured points say how large a vehicle is its class does not matter.

    Args:
        problem: What was solved.
        camera_T_object: (4, 4) the result's pose.
        coefficients: (N,) its shape.
        setup: What holds for all vehicles of the call.
        classes: Probability of each class as far as somebody says it; None where nobody does.
        alone: Where the vehicle by itself ended, solved as one of its fleet, which is of the first class then; None to
            solve it so.
    """
    observation, names = problem.observation, open_classes(classes, setup, in_traffic=True)
    counted = names and counts_classes(problem.options) and not setup.is_measured(observation, problem.camera)
    if not counted or not np.isfinite(camera_T_object).all():
        return None
    ends = dict[str, _Solved]()
    for name in names:
        if name == names[0] and alone is not None and classes is None:
            end = _Solved.of(alone, problem)
        else:
            end = _solved_as(name, problem, camera_T_object, coefficients, setup)
        if end is not None:
            ends[name] = end
    if len(ends) < 2:
        return None
    if classes is not None and any(isinstance(one, FittedClass) for one in observation.evidence):
        first = classes[next(iter(ends))]  # with its image already
        weights = {name: math.log(classes[name] / first) for name in ends}
    else:
        odds, given = odds_before_image([*ends], classes, setup)
        weights = {name: odds[name] + given[name] for name in ends}
        weights = with_energies(weights, {name: end.energy for name, end in ends.items()})
    return _between(ends, weights, problem, setup)


def with_either_class(result: Reconstruction, problem: Problem, setup: SolveSetup, alone: Optimum) -> Reconstruction:
    """The result of a vehicle in one image, with covariances for all classes where its class is open.

    Args:
        problem: What was solved.
        setup: What holds for all vehicles of the call.
        alone: Where the vehicle by itself ended.
    """
    if result.uncertainty.pose_covariance is None:
        return result
    classes = setup.classes_of([problem.observation])
    either = either_class(problem, result.camera_T_object, result.shape.coefficients, setup, classes, alone)
    return result if either is None else either.added_to(result, either.weights)


def mean_weights(frames: Iterable[EitherClass | None]) -> dict[str, float]:
    """Log weights of classes by frames of one vehicle; of none where none says anything.

    Frames count that have the first class of the first of them, beside which all weights are.
    """
    known = [one.weights for one in frames if one is not None]
    if not known:
        return {}
    first = next(iter(known[0]))
    beside = [{name: own - one[first] for name, own in one.items()} for one in known if first in one]
    names = dict.fromkeys(name for one in beside for name in one)
    each = {name: [one[name] for one in beside if name in one] for name in names}
    return {name: sum(some) / len(some) for name, some in each.items()}


def _spread(spread: Array, ways: Array) -> Array:
    """(..., D, D) covariance of what goes along ways (C - 1, ..., D) by shares of a covariance (C - 1, C - 1)."""
    pairs = ways[:, None, ..., :, None] * ways[None, :, ..., None, :]
    found: Array = np.tensordot(spread, pairs, 2)
    return found


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
    if model.prior.category is not problem.model.prior.category:
        return None  # its classes are of another shape by a hair
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


def _between(
    ends: Mapping[str, _Solved], weights: Mapping[str, float], problem: Problem, setup: SolveSetup
) -> EitherClass:
    """What lies between the ends."""
    first, *others = ends.values()
    apart = np.array([end.keypoints - first.keypoints for end in others])
    sizes = np.array([end.size - first.size for end in others])
    return EitherClass(
        weights,
        np.array([_turn(first.pose, end.pose) for end in others]),
        first.pose.translation(),
        np.array([end.pose.translation() - first.pose.translation() for end in others]),
        np.array([problem.model.by_keypoints @ one.ravel() for one in apart]),
        apart,
        sizes,
        first.size,
        np.array([_spreads_more(name, sizes, problem, setup) for name in ends]),
    )


def _turn(first: gtsam.Pose3, other: gtsam.Pose3) -> Array:
    """(3,) rotation of one pose against the first, radians; none where it is flipped, which the facing says."""
    if is_flipped(first.matrix(), other.matrix()):
        return np.zeros(3)
    turn: Array = gtsam.Rot3.Logmap(first.rotation().between(other.rotation()))
    return turn


def _spreads_more(name: str, ways: Array, problem: Problem, setup: SolveSetup) -> list[float]:
    """By how much the sizes of a class spread more along each way (C - 1, 3) than those of the model do.

    In shares of the way, squared.
    """
    counted, own = problem.model.size, setup.model_as(name).size
    if counted is None or own is None:
        return [0.0] * len(ways)
    more = own.own_spread - counted.own_spread
    return [float(size @ more @ size) / max(float(size @ size), 1e-12) ** 2 for size in ways]
