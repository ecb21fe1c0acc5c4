"""Points of a scan that two vehicles of an image are on: one of them is in the other's place, before or behind its own.

A vehicle that shows few points goes to those of the one that hides it, as long as each is solved by itself. The points
are that one's with which the picture agrees more in that place, and the other is solved again without them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from itertools import permutations

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.arrays import Array
from fgrecon.core.evidence import Points
from fgrecon.core.observation import Observation
from fgrecon.solve.graph.multi_start import MultiStartResult
from fgrecon.solve.proposals.point_term import POINTS, POINTS_NAME

_WRONG_SIGMAS = 5.0  # by how many standard deviations a wrong keypoint is off


def without_claimed(
    observations: Mapping[int, Observation], ends: Mapping[int, MultiStartResult]
) -> dict[int, Observation]:
    """The observations of vehicles in others' places, without the points of these.

    Args:
        observations: The observations of an image's vehicles, by number.
        ends: Where each ended by itself; of some.
    """
    scanned = [n for n in ends if any(isinstance(one, Points) for one in observations[n].evidence)]
    found: dict[int, Observation] = {}
    for one, other in permutations(scanned, 2):
        points, weights = ends[one].graph.points_of(0)
        own = points[weights >= POINTS.used_weight]
        if len(own) and inside(own, ends[other]).mean() >= POINTS.claimed_share:
            owner, guest = sorted((one, other), key=lambda number: _picture_energy(ends[number]))
            found[guest] = _without(found.get(guest, observations[guest]), ends[owner])
    return found


def inside(points: Array, end: MultiStartResult) -> NDArray[np.bool_]:
    """(M,) which points (M, 3) of the camera's frame are in the 3D box of a vehicle that was solved by itself."""
    state, model = end.optimum.state, end.graph.observations[0].problem.model
    pose, (coefficients, _) = state.poses[0].matrix(), state.shapes[0]
    length, width, height = model.dimension_mean + model.dimension_basis @ coefficients
    local = (points - pose[:3, 3]) @ pose[:3, :3] + np.array([0.0, height / 2.0, 0.0])
    reach = np.array([length, height, width]) / 2.0 + POINTS.claimed_margin_m
    return np.all(np.abs(local) < reach, axis=1)


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


def _without(observation: Observation, owner: MultiStartResult) -> Observation:
    evidence = tuple(
        one.chosen(~inside(one.points, owner)) if isinstance(one, Points) else one for one in observation.evidence
    )
    return replace(observation, evidence=evidence)
