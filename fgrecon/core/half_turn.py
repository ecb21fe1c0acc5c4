"""The heading flip of a vehicle's keypoints as a whole: the same points under the names of their partners.

A network that takes a front for a rear detects the left front wheel where the right rear wheel is, and so on. Flipped,
such an observation says what a right one would have said. Partners are opposite corners of a face that is its
own mirror image, as of the quad of the wheels; else half a turn about the vertical axis takes one of the prior's mean
shape near the other.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.observation import Observation
from fgrecon.core.reconstruction import Alternative
from fgrecon.core.shape_prior import ShapePrior

HALF_TURN = np.diag([-1.0, 1.0, -1.0, 1.0])
"""(4, 4) half a turn about the object's own y axis."""
HALF_TURN.setflags(write=False)

_MOST_EXCESS = 12.0  # nats: a flipped vehicle that is less probable by more is no alternative
_LEAST_PROBABILITY = 1e-12  # probability
_PARTNER_DISTANCE = 0.2  # of the shape's length: a point further from every other one has no partner


@lru_cache(maxsize=16)
def partners(prior: ShapePrior) -> NDArray[np.intp]:
    """(K,) index of the keypoint that each takes the place of in a vehicle turned by half; -1 where there is none."""
    mean = prior.mean - np.array([0.5, 0.0, 0.0]) * (prior.mean.max(axis=0) + prior.mean.min(axis=0))
    turned = mean * np.diag(HALF_TURN)[:3]
    apart = np.linalg.norm(turned[:, None] - mean[None], axis=2)
    nearest = apart.argmin(axis=1)
    found: NDArray[np.intp] = np.where(apart.min(axis=1) <= _PARTNER_DISTANCE * np.ptp(mean[:, 0]), nearest, -1)
    for face in prior.category.faces:
        corners = face.keypoints
        mirrored = {int(prior.category.mirror[i]) for i in corners} == set(corners)
        if len(corners) == 4 and mirrored and np.ptp(mean[list(corners), 0]) > _PARTNER_DISTANCE * np.ptp(mean[:, 0]):
            found[list(corners)] = np.roll(corners, 2)
    return np.where((found >= 0) & (found[found] == np.arange(len(mean))), found, -1)


def flipped_observation(observation: Observation, prior: ShapePrior) -> Observation:
    """The observation of the vehicle turned by half; points without a partner are not measured."""
    renamed, azimuth = observation.renamed(partners(prior)), observation.azimuth
    return renamed if azimuth is None else renamed.with_directions(flipped_directions(azimuth))


def flipped_alternative(
    camera_T_object: NDArray[np.float64], coefficients: NDArray[np.float64], facing: float
) -> tuple[Alternative, ...]:
    """The flipped vehicle, as improbable as it is; none where it is out of the question.

    Args:
        camera_T_object: (4, 4) its pose.
        coefficients: (N,) its shape.
        facing: Probability that it faces where the pose says.
    """
    behind = float(np.log(max(facing, _LEAST_PROBABILITY)) - np.log(max(1.0 - facing, _LEAST_PROBABILITY)))
    return () if behind > _MOST_EXCESS else (Alternative(camera_T_object @ HALF_TURN, coefficients, behind),)


def flipped_directions(azimuth: NDArray[np.float64]) -> NDArray[np.float64]:
    """(A,) probabilities of directions, each given to the opposite one."""
    bins = len(azimuth)
    if bins % 2 == 0:
        return np.roll(azimuth, bins // 2)
    return np.asarray((np.roll(azimuth, bins // 2) + np.roll(azimuth, bins // 2 + 1)) / 2.0)
