"""Keypoints that two vehicles of an image claim: one point of it is a keypoint of one vehicle only.

A network that is shown the box of a hidden car often finds the car before it, and where that one has its own box its
keypoints are there twice. Which of both is right their confidences say: of two claims that exclude each other, right
with p and q by themselves, the first is right with p (1 - q) / (1 - p q).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from fgrecon.core.observation import Observation
from fgrecon.core.options import KeypointOptions
from fgrecon.solve.solve_settings import SCENE


def with_exclusive_keypoints(observations: Sequence[Observation], options: KeypointOptions) -> list[Observation]:
    """The observations of an image, less confident of keypoints where another vehicle has the same one.

    Args:
        observations: Of one category, without lens distortion.
        options: How far keypoints are off: two are at one point that are no farther apart than their noise.
    """
    if len(observations) < 2:
        return [*observations]
    pixels = np.stack([one.keypoints for one in observations])
    right = np.minimum([one.confidence for one in observations], SCENE.most_certain_claim)
    extents = np.array([one.extent for one in observations])
    variance = (options.sigma_relative * extents) ** 2 + options.sigma_pixels**2  # of a keypoint along one axis
    found = []
    for i, one in enumerate(observations):
        farthest = SCENE.same_point_sigmas**2 * (variance[i] + variance)
        same = ((pixels - pixels[i]) ** 2).sum(axis=2) < farthest[:, None]  # never of a NaN
        same[i] = False
        if same.any():
            share = np.where(same, (1.0 - right) / (1.0 - right[i] * right), 1.0).prod(axis=0)
            one = replace(one, confidence=one.confidence * share)
        found.append(one)
    return found
