"""Restarts of the search where a pose rests on few keypoints: all round and about the pose, with a shape that moves.

The first search moves the mean shape, which is quick, and enough wherever many keypoints hold the vehicle. Where three
or four do, another shape meets one keypoint more, or the same ones from metres further away or with another tilt. Such
a minimum faces the same way as the estimated pose, and the mean shape has none there. Whether a pose rests on few
keypoints is known only at its end.

A keypoint that the result takes for wrong pulls at nothing, so that no start comes to where it is right unless it is
close by. Each of those that may be right is therefore taken for right, whatever that costs, and the search goes on from
there with the true energy.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fgrecon.core.arrays import Array
from fgrecon.core.geometry import exponential
from fgrecon.core.reconstruction import Alternative
from fgrecon.solve.proposals.problem import Problem
from fgrecon.solve.proposals.search import PoseEnergy, search
from fgrecon.solve.proposals.search_settings import SETTINGS
from fgrecon.solve.proposals.starts import at_azimuths, view_box
from fgrecon.solve.proposals.terms import Hypotheses

RESTARTS = SETTINGS.restarts


def lower_poses(problem: Problem, camera_T_object: Array, coefficients: Array, again: int = 0) -> list[Alternative]:
    """Poses and shapes of less energy than that of a pose and shape.

    Args:
        problem: What is to be solved.
        camera_T_object: (4, 4) the pose.
        coefficients: (N,) the shape.
        again: How often it was searched before: the starts are others each time.

    Returns:
        At most three, best first, each near a minimum of the energy. Their excess is negative.
    """
    here = Hypotheses(camera_T_object[None, :3, :3], camera_T_object[None, :3, 3], coefficients[None])
    total, weights = problem.energy.evaluate(here)
    energy = float(total.energy[0])

    def starts(all_round: int, about: int) -> Hypotheses:
        return Hypotheses.joined(
            [_all_round(problem, all_round, again), _about(camera_T_object, coefficients, about, again)]
        )

    first_kept = {RESTARTS.kept_from_iteration: RESTARTS.first_kept_hypotheses}
    each_kept = {RESTARTS.kept_from_iteration: RESTARTS.keypoint_kept_hypotheses}
    first = starts(RESTARTS.all_round_starts, RESTARTS.nearby_starts)
    left = [search(problem.energy, first, RESTARTS.first_iterations, first_kept).hypotheses]
    each = starts(RESTARTS.starts_per_keypoint, RESTARTS.starts_per_keypoint)
    right = problem.energy.keypoints.evidence.right
    wrong = np.flatnonzero((weights[0] < RESTARTS.wrong_below_weight) & (right > RESTARTS.least_right_probability))
    for keypoint in wrong[np.argsort(-right[wrong], kind="stable")][: RESTARTS.most_assumed_right].tolist():
        assumed = _assumed_right(problem.energy, keypoint)
        left.append(search(assumed, each, RESTARTS.keypoint_iterations, each_kept).hypotheses)
    refined = search(problem.energy, Hypotheses.joined(left), RESTARTS.last_iterations, {})
    poses, kept = refined.hypotheses.matrices(), [camera_T_object]
    lower: list[Alternative] = []
    for i in np.flatnonzero(refined.energy < energy - RESTARTS.energy_gap_nats).tolist():
        if not _is_one_of(poses[i], kept):
            kept.append(poses[i])
            lower.append(Alternative(poses[i], refined.hypotheses.coefficients[i], float(refined.energy[i]) - energy))
            if len(lower) == RESTARTS.most_poses:
                break
    return lower


def _assumed_right(energy: PoseEnergy, keypoint: int) -> PoseEnergy:
    """The energy with a measured keypoint that cannot be wrong."""
    term = energy.keypoints
    right, outlier = term.evidence.right.copy(), term.evidence.outlier.copy()
    right[keypoint], outlier[keypoint] = 1.0, RESTARTS.never_wrong_density
    return replace(energy, keypoints=replace(term, evidence=replace(term.evidence, right=right, outlier=outlier)))


def _is_one_of(pose: Array, known: list[Array]) -> bool:
    poses = np.array(known)
    cosine = ((poses[:, :3, :3] * pose[:3, :3]).sum(axis=(1, 2)) - 1.0) / 2.0
    near = np.linalg.norm(poses[:, :3, 3] - pose[:3, 3], axis=1) < RESTARTS.same_shift_metres
    return bool((near & (cosine > np.cos(RESTARTS.same_turn_radians))).any())


def _all_round(problem: Problem, count: int, again: int) -> Hypotheses:
    """The mean shape at all azimuths, tilted, nearer and farther than where it fills the box."""
    azimuths = 2.0 * np.pi * (np.arange(count) + again / RESTARTS.azimuth_period) / count
    box = view_box(problem.observation)
    h = at_azimuths(box, problem.camera, problem.model, problem.ground, azimuths, relative=True)
    farther, roll, pitch = _spread(count, 3, again).T
    tilt = exponential(RESTARTS.tilt_spread_radians * np.stack([roll, np.zeros(count), pitch], axis=1))
    away = np.exp(RESTARTS.log_depth_spread * farther)
    return Hypotheses(h.rotation @ tilt, h.translation * away[:, None], h.coefficients)


def _about(camera_T_object: Array, coefficients: Array, count: int, again: int) -> Hypotheses:
    """The pose turned, tilted, nearer and farther, with shapes of the prior."""
    spread = _spread(count, 4 + len(coefficients), again)
    turn, roll, pitch, farther = spread[:, :4].T
    tilt = RESTARTS.nearby_tilt_spread_radians
    rotation = exponential(np.stack([tilt * roll, RESTARTS.nearby_turn_spread_radians * turn, tilt * pitch], axis=1))
    translation = camera_T_object[:3, 3] * np.exp(RESTARTS.nearby_log_depth_spread * farther)[:, None]
    return Hypotheses(camera_T_object[:3, :3] @ rotation, translation, spread[:, 4:])


def _spread(count: int, dimension: int, again: int) -> Array:
    """(count, dimension) points that fill the cube from -1 to 1 evenly (Roberts' sequence), others each time."""
    ratio = 2.0
    for _ in range(50):  # to the root of x^(dimension + 1) = x + 1
        ratio = (1.0 + ratio) ** (1.0 / (dimension + 1))
    index = np.arange(1, count + 1) + again * count
    return 2.0 * ((0.5 + np.outer(index, ratio ** -np.arange(1.0, dimension + 1))) % 1.0) - 1.0
