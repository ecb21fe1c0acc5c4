"""Motion factors between two frames of one vehicle, and on its velocity in one.

Where the camera's own motion is known they are those of the category; else only that a vehicle's motion relative to the
camera changes smoothly is left.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import gtsam
import numpy as np

from factors.keys import V, X
from factors.linear import Walk, ZeroPrior
from factors.losses import Loss, RobustLoss
from factors.motion import drive_factor, motion_factor
from factors.noise import diagonal_noise, full_noise
from fgrecon.core.arrays import Array
from fgrecon.core.category import MotionModel
from fgrecon.solve.time.frame import FrameStep
from fgrecon.solve.time.time_settings import SETTINGS


def between_terms(
    frames: tuple[int, int],
    step: FrameStep,
    pose: gtsam.Pose3,
    model: MotionModel,
    *,
    share: float = 1.0,
    alike: bool = True,
) -> tuple[gtsam.NonlinearFactor, ...]:
    """The factors between two frames of vehicle 0.

    Args:
        frames: Their numbers.
        step: From the first to the second.
        pose: Of the vehicle in the second, about where it is as unsure as the camera's motion leaves it.
        model: The category's motion.
        share: Of their information that the factors have.
        alike: Whether the velocities in both are of one kind: over the world, or relative to the camera.
    """
    if step.camera is None:
        return _by_unknown_camera(frames, step.seconds, share, alike)
    across = model.slip if model.wheeled else model.acceleration
    walk = (model.acceleration, across, model.turning)
    unsure = step.seconds * np.diag(np.array(SETTINGS.motion_sigma) ** 2) + step.carried(pose)
    return _between(
        frames, step.seconds, step.camera, unsure / share, _walk(walk, step.seconds, share) if alike else None
    )


@lru_cache(maxsize=1024)
def _by_unknown_camera(
    frames: tuple[int, int], seconds: float, share: float, alike: bool
) -> tuple[gtsam.NonlinearFactor, ...]:
    """Those that depend on no pose: the same in one window after the other."""
    unsure = seconds * np.diag(np.array(SETTINGS.unknown_camera_sigma) ** 2)
    walk = _walk(SETTINGS.relative_velocity_walk, seconds, share) if alike else None
    return _between(frames, seconds, None, unsure / share, walk)


def _walk(change: Sequence[float], seconds: float, share: float) -> Array:
    """(3,) standard deviation of a velocity's change, for that in a second."""
    return np.array(change) * np.sqrt(seconds) / np.sqrt(share)


def _between(
    frames: tuple[int, int], seconds: float, camera: gtsam.Pose3 | None, covariance: Array, walk: Array | None
) -> tuple[gtsam.NonlinearFactor, ...]:
    first, second = frames
    noise = full_noise("motion", covariance)
    between = motion_factor(X(0, first), V(0, first), X(0, second), seconds, noise, camera)
    if walk is None:
        return (between,)
    return between, Walk(V(0, first), V(0, second), diagonal_noise("walk", walk))


@lru_cache(maxsize=1024)
def velocity_terms(
    frame: int, seconds: float, model: MotionModel, *, known: bool, share: float = 1.0, stands: bool | None = None
) -> tuple[gtsam.NonlinearFactor, ...]:
    """The factors about the velocity of vehicle 0 in a frame; the same in one window after the other.

    Args:
        frame: Its number.
        seconds: That it stands for: what is said of every frame must not count by their number.
        model: The category's motion.
        known: Whether the camera's motion is known, and the velocity is over the world.
        share: Of their information that the factors have; that it stands, where that is known, counts whole.
        stands: Whether it stands; None where it may.
    """
    root = np.sqrt(share * seconds)
    key, (forward, across, turning) = V(0, frame), SETTINGS.velocity_sigma
    if not known or not model.wheeled:
        return (drive_factor(key, diagonal_noise("velocity", np.array(SETTINGS.velocity_sigma) / root)),)
    if stands:
        sigma = np.array([model.standing, model.standing, SETTINGS.standing_turn_rate_rad_per_s]) / np.sqrt(seconds)
        return (ZeroPrior(key, diagonal_noise("standing", sigma)),)
    drive = drive_factor(key, diagonal_noise("drive", np.array([forward, model.slip, 1.0]) / root), model.radius)
    if stands is not None:
        return (drive,)
    still = diagonal_noise("standing", np.array([model.standing, across, turning]) / root)
    return drive, ZeroPrior(key, RobustLoss.of(Loss.CAUCHY, SETTINGS.standing_loss_sigmas * root).wrap(still))
