"""Detection of mirrored keypoints: of a mirrored image, or with left and right by the viewer's sides."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.errors import FgreconError
from fgrecon.core.input_warnings import SETTINGS, fit_share
from fgrecon.core.observation import Observation
from fgrecon.core.reconstruction import Reconstruction
from fgrecon.solve.proposals.pose_search import search_pose
from fgrecon.solve.proposals.problem import Problem
from fgrecon.solve.weakness import weakened


def with_mirrored_gain(result: Reconstruction, problem: Problem) -> Reconstruction:
    """The result with what exchanging left and right gains, weak where that is much.

    Args:
        result: Of the vehicle by itself, or in a scene.
        problem: What was solved.
    """
    observation = problem.observation
    share = fit_share(observation, result.diagnostics.weights)
    if observation.azimuth is not None or share is None or share >= SETTINGS.unmirrored_share:
        return result
    mirror = np.array(problem.model.prior.category.mirror)
    try:
        exchanged = problem.showing(_exchanged(observation, mirror))
        there = search_pose(exchanged)
        gain = search_pose(problem).energy - there.energy
    except FgreconError:
        return result
    after = fit_share(exchanged.observation, there.weights)
    if after is None or after < SETTINGS.unmirrored_share:  # neither fits
        return result
    found = replace(result, diagnostics=replace(result.diagnostics, mirrored_gain=float(gain)))
    if not gain > SETTINGS.mirrored_gain_nats:
        return found
    return weakened(found, [f"its keypoints fit better with left and right exchanged, by {gain:.0f} nats"])


def _exchanged(observation: Observation, mirror: NDArray[np.intp]) -> Observation:
    covariance = observation.covariance
    return replace(
        observation,
        keypoints=observation.keypoints[mirror],
        confidence=observation.confidence[mirror],
        covariance=None if covariance is None else covariance[mirror],
    )
