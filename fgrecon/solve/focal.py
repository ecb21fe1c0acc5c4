"""Unknown focal length: a variable that all vehicles of an image share.

Nearness and a short focal length make a vehicle's image alike, and only perspective tells them apart: how much larger
the near end looks than the far one. A vehicle alone tells little, several that are near tell much. The energy may have
several minima over the focal length, in which vehicles have other poses; so vehicles are first solved alone with some
focal lengths of the prior, and where these sum to a minimum is a start of the joint graph, in which the focal length is
the variable F(0) with the prior as a factor.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import gtsam
import numpy as np

from factors.keys import F
from factors.noise import diagonal_noise
from fgrecon.core.camera import Camera
from fgrecon.core.errors import InvalidInputError
from fgrecon.solve.independent import IndependentSolve
from fgrecon.solve.solve_settings import SCENE


def candidates(camera: Camera) -> list[Camera]:
    """Cameras with the focal lengths to try: the camera alone where its own is known.

    Raises:
        InvalidInputError: The lens is distorted, which belongs to a known focal length.
    """
    if camera.focal_sigma == 0.0:
        return [camera]
    if camera.distortion is not None:
        fix = "Give the focal length that the coefficients were calibrated with, or leave them out."
        raise InvalidInputError("distortion", "given without a known focal length", fix)
    reach = SCENE.focal_reach_sigmas
    steps = np.linspace(-reach, reach, SCENE.focal_candidates) * camera.focal_sigma
    return [replace(camera.scaled(math.exp(step)), focal_sigma=0.0) for step in steps.tolist()]


def log_ratio(camera: Camera, to: Camera) -> float:
    """Logarithm of a camera's focal length in terms of another's."""
    return float(np.log(camera.matrix[0, 0] / to.matrix[0, 0]))


def focal_prior(known: Camera, nominal: Camera) -> gtsam.PriorFactorVector:
    """What is known of the focal length, as a factor on its ratio to that of the nominal camera."""
    noise = diagonal_noise("focal_sigma", np.array([known.focal_sigma]))
    return gtsam.PriorFactorVector(F(0), np.array([log_ratio(known, nominal)]), noise)


def energies_of(tried: Sequence[IndependentSolve], known: Camera) -> list[float]:
    """The energy with each of the cameras, of the vehicles that were solved with all of them."""
    if len(tried) == 1:
        return [0.0]
    common = set.intersection(*(set(one.solved) for one in tried))
    if not common:
        return [math.inf] * len(tried)
    return [
        sum(one.vehicles[number].adjusted.optimum.energy for number in common)
        + 0.5 * (log_ratio(one.camera, known) / known.focal_sigma) ** 2
        for one in tried
    ]


def starts(energies: Sequence[float]) -> list[int]:
    """Which of the tried focal lengths the joint graph starts from, the best first.

    Args:
        energies: Of all vehicles alone with each, the prior's included; infinite where too few can be solved.
    """
    padded = [math.inf, *energies, math.inf]
    least = min(energies)
    minima = [
        i
        for i, energy in enumerate(energies)
        if energy <= padded[i] and energy < padded[i + 2] and energy <= least + SCENE.focal_start_excess_nats
    ]
    return sorted(minima, key=lambda i: energies[i])[: SCENE.focal_starts]


def distinct_lengths(lengths: Sequence[tuple[float, float]]) -> tuple[tuple[float, float], ...]:
    """Focal lengths and their energies, the best first, without those that are one of the better ones again."""
    kept: list[tuple[float, float]] = []
    for pixels, excess in lengths:
        if all(abs(math.log(pixels / other)) > SCENE.same_focal_log for other, _ in kept):
            kept.append((pixels, excess))
    return tuple(kept)
