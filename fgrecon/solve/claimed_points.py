"""Points of a scan claimed by two vehicles of an image: one of them is in the other's place, before or behind its own.

A vehicle that shows few points goes to those of the one that hides it, as long as each is solved by itself. The points
are that one's with which the picture agrees more in that place, or of two that were seen before that one's which was
to come there. The other is solved again without them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import permutations

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.arrays import Array
from fgrecon.core.evidence import Points
from fgrecon.core.observation import Observation
from fgrecon.solve.graph.multi_start import MultiStartResult
from fgrecon.solve.proposals.point_term import POINTS, POINTS_NAME
from fgrecon.solve.proposals.problem import Problem
from fgrecon.solve.vehicle.model import VehicleModel

_WRONG_SIGMAS = 5.0  # by how many standard deviations a wrong keypoint is off


@dataclass(frozen=True, eq=False)
class TakenPlace:
    """Where a vehicle is, and which measured points it takes for its own."""

    pose: Array  # (4, 4)
    model: VehicleModel
    coefficients: Array  # (N,)
    points: Array  # (M, 3) those that it takes
    known_by: MultiStartResult | float  # the solve of its image; or metres from where it was to come, if seen before

    @classmethod
    def of(cls, end: MultiStartResult) -> TakenPlace:
        """Of a vehicle that was solved by itself."""
        points, weights = end.graph.points_of(0)
        state, model = end.optimum.state, end.graph.observations[0].problem.model
        return cls(state.poses[0].matrix(), model, state.shapes[0][0], points[weights >= POINTS.used_weight], end)

    @classmethod
    def expected(cls, problem: Problem, pose: Array, coefficients: Array, foreseen: Array) -> TakenPlace:
        """Of a vehicle that was seen before, at its pose (4, 4) in this image, beside the one that it should have."""
        own = [np.zeros((0, 3))]
        for term in (one for one in problem.energy.points if one.name == POINTS_NAME):
            match = term.rows.match(pose[:3, :3], pose[:3, 3], coefficients)
            off, _ = term.rows.distances(match, pose[:3, :3], pose[:3, 3], coefficients, want=False)
            own.append(term.rows.points[term.rows.assess(match, off)[0] >= POINTS.used_weight])
        away = float(np.linalg.norm(pose[:3, 3] - foreseen[:3, 3]))
        return cls(pose, problem.model, coefficients, np.concatenate(own), away)

    @property
    def doubt(self) -> tuple[float, float]:
        """Of two in one place the one with less stays: metres from where it was to come, and nats of the picture."""
        return (self.known_by, 0.0) if isinstance(self.known_by, float) else (np.inf, _picture_energy(self.known_by))

    def holds(self, points: Array) -> NDArray[np.bool_]:
        """(M,) which points (M, 3) of the camera's frame are in the vehicle's 3D box."""
        length, width, height = self.model.dimension_mean + self.model.dimension_basis @ self.coefficients
        local = (points - self.pose[:3, 3]) @ self.pose[:3, :3] + np.array([0.0, height / 2.0, 0.0])
        reach = np.array([length, height, width]) / 2.0 + POINTS.claimed_margin_m
        return np.all(np.abs(local) < reach, axis=1)


def is_scanned(observation: Observation) -> bool:
    """Whether an observation has measured points."""
    return any(isinstance(one, Points) for one in observation.evidence)


def without_claimed(
    observations: Mapping[int, Observation], places: Mapping[int, TakenPlace]
) -> dict[int, Observation]:
    """The observations of vehicles in others' places, without the points of these.

    Args:
        observations: The observations of an image's vehicles, by number.
        places: Where each of them that has points is as long as it is looked at by itself; of some.
    """
    found: dict[int, Observation] = {}
    for one, other in permutations(places, 2):
        own = places[one].points
        if len(own) and places[other].holds(own).mean() >= POINTS.claimed_share:
            owner, guest = sorted((one, other), key=lambda number: places[number].doubt)
            found[guest] = _without(found.get(guest, observations[guest]), places[owner])
    return found


def _picture_energy(end: MultiStartResult) -> float:
    """What all but the points say against where a vehicle is, nats.

    Of its keypoints it counts how much better they fit there than wrong ones: what these cost depends on the detector.
    """
    weights = end.optimum.state.weights
    energies = end.graph.energies(end.optimum.values, weights)
    term = end.graph.observations[0].problem.energy.keypoints
    squares = np.full(len(term.mean), _WRONG_SIGMAS**2)
    _, wrong = term.strategy.evaluate(squares, term.evidence, weights[0].visibility)
    return sum(energy for name, energy in energies.items() if name != POINTS_NAME) - float(wrong)


def _without(observation: Observation, owner: TakenPlace) -> Observation:
    evidence = tuple(
        one.chosen(~owner.holds(one.points)) if isinstance(one, Points) else one for one in observation.evidence
    )
    return replace(observation, evidence=evidence)
