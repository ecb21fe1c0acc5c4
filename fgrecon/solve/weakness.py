"""Reasons why a converged result is weak: few keypoints carry it, or it is at the edge of what was given.

Chosen on five drives of KITTI's video and tested on two others (`docs/reference/result.md`). What is said of a focal
length that was found holds for all vehicles that tell it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from fgrecon.core.arrays import Array
from fgrecon.core.box3d import box_corners
from fgrecon.core.camera import Camera, Ground
from fgrecon.core.geometry import transform
from fgrecon.core.input_warnings import POINTS_CONTRADICT, REASONS, InputWarning, camera_warning_of, in_the_air
from fgrecon.core.input_warnings import SETTINGS as INPUT_WARNINGS
from fgrecon.core.observation import Observation
from fgrecon.core.reconstruction import Reconstruction
from fgrecon.core.result_fields import Status
from fgrecon.solve.solve_settings import STATUS


def weaknesses(
    observation: Observation,
    weights: Array,
    camera: Camera,
    camera_T_object: Array,
    coefficients: Array,
    box_size: Array,
    ground: Ground | None,
    points: float = 0.0,
) -> tuple[str, ...]:
    """Clauses that say why a result is weak; none where it is not.

    Args:
        observation: What it was solved from.
        weights: (K,) final weights of the keypoints.
        camera_T_object: (4, 4) pose.
        coefficients: (N,) shape coefficients.
        box_size: (3,) length, width and height, metres.
        ground: The plane that is given, or None.
        points: Weight of measured points on its surface.
    """
    found = []
    if weights.sum() + points / STATUS.points_a_keypoint < STATUS.carrying_keypoints:
        found.append(f"keypoints of weight {weights.sum():.1f} of {len(weights)} carry it")
    measured = observation.measured
    probable = float(observation.right[measured].mean()) if measured.any() else 0.0
    if probable < STATUS.right_keypoints and points < STATUS.carrying_keypoints * STATUS.points_a_keypoint:
        found.append(f"the detector holds {100 * probable:.0f} % of its keypoints right")
    right = float(observation.right[measured].sum())
    if points > 0.0 and weights.sum() < STATUS.fitting_keypoints * right:
        found.append(f"{POINTS_CONTRADICT} its image: keypoints of weight {weights.sum():.1f} fit, of {right:.1f}")
    if camera.image_size is not None:
        outside = _outside(camera, camera_T_object, box_size)
        if outside > STATUS.outside_image:
            found.append(f"{100 * outside:.0f} % of its box is outside of the image")
    if len(coefficients) and (largest := float(np.abs(coefficients).max())) > STATUS.shape_sigmas:
        found.append(f"its shape is {largest:.1f} standard deviations from the mean")
    if ground is not None:
        found += against_ground(camera_T_object, ground, STATUS.leaning_sigmas)
    elif in_the_air(camera_T_object):
        found.append(REASONS[InputWarning.AIR])
    if np.linalg.norm(camera_T_object[:3, 3]) > INPUT_WARNINGS.farthest_m:
        found.append(REASONS[InputWarning.FAR])
    if (warning := camera_warning_of(camera)) is not None:
        found.append(REASONS[warning])
    return tuple(found)


def against_ground(camera_T_object: Array, ground: Ground, leaning_sigmas: float) -> list[str]:
    """The clauses of a vehicle at a pose (4, 4) that is off the ground that is given, or leans on it by so much."""
    sigma = ground.height_sigma_at_depth(float(camera_T_object[2, 3]))
    found = off_ground(float(ground.normal @ camera_T_object[:3, 3] - ground.distance), sigma)
    lean = math.acos(min(float(ground.normal @ camera_T_object[:3, 1]), 1.0))
    if lean > leaning_sigmas * ground.tilt_sigma:
        sigmas = f"{lean / ground.tilt_sigma:.1f} standard deviations"
        found.append(f"it leans by {math.degrees(lean):.0f} degrees on the ground, {sigmas}")
    return found


def off_ground(below: float, sigma: float) -> list[str]:
    """The clause of a vehicle whose origin is so many metres below the ground, known to `sigma` metres there."""
    if abs(below) <= STATUS.off_ground_sigmas * sigma:
        return []
    side = "below" if below > 0.0 else "above"
    return [f"it is {abs(below):.2f} m {side} the ground, {abs(below) / sigma:.1f} standard deviations"]


def too_large_box(excess: float) -> list[str]:
    """The clause of a vehicle whose 2D box is larger than it looks by such a share; NaN where nothing says so."""
    if not excess > STATUS.large_box_excess:
        return []
    return [f"its 2D box is {100 * excess:.0f} % larger than it looks"]


def too_fast(speed: float) -> list[str]:
    """The clause of a vehicle that goes so many metres a second as none does."""
    if speed <= STATUS.fastest_m_per_s:
        return []
    return [f"it goes {speed:.0f} m/s: are the times of the frames seconds, and all of them there?"]


def unknown_focal(
    sigma: float, lengths: Sequence[tuple[float, float]], margin: float
) -> tuple[Status, tuple[str, ...]]:
    """What becomes of vehicles that converged with a focal length that was found, and clauses that say why.

    Args:
        sigma: Standard deviation of its logarithm that is left; 0 where it was known.
        lengths: Focal lengths that explain the image, pixels, the best first, and how many nats worse each is.
        margin: Nats within which another one leaves open which it is (`Options.ambiguity_margin`).
    """
    found = []
    best = lengths[0][0] if lengths else math.nan
    others = [o for o in lengths[1:] if o[1] <= margin and abs(math.log(o[0] / best)) > STATUS.rough_focal_log]
    if others:
        (other, excess), *_ = others
        found.append(f"focal lengths of {best:.0f} and {other:.0f} px explain the image, {excess:.1f} nats apart")
    if sigma > STATUS.rough_focal_log:
        found.append(f"the focal length is known to {100 * sigma:.0f} % only, and distances no better")
    return Status.AMBIGUOUS if others or sigma > STATUS.open_focal_log else Status.WEAK, tuple(found)


def weakened(result: Reconstruction, reasons: Sequence[str], status: Status = Status.WEAK) -> Reconstruction:
    """The result with further reasons to be weak, or ambiguous, which it is where it had converged."""
    if not reasons:
        return result
    every = (*result.reasons, *reasons)
    if not result.status.settled:
        return replace(result, reasons=every)
    text = "; ".join(every if status is Status.WEAK else reasons)
    return replace(result, status=status, message=f"{text[0].upper()}{text[1:]}.", reasons=every)


def _outside(camera: Camera, camera_T_object: Array, box_size: Array) -> float:
    """Share of the 2D box around the vehicle that is not in the image; 1 where it reaches behind the camera."""
    assert camera.image_size is not None
    corners = transform(camera_T_object, box_corners(box_size))
    if corners[:, 2].min() <= 0.0:
        return 1.0
    pixels = camera.project(corners)
    box = np.array([pixels.min(axis=0), pixels.max(axis=0)])
    inside = np.clip(box, -0.5, np.array(camera.image_size) - 0.5)
    return float(1.0 - np.prod(inside[1] - inside[0]) / np.prod(box[1] - box[0]))
