"""The motion factors between two frames of one vehicle, and about its velocity in one.

Where the camera's own motion is known they are those of the category; else only that a vehicle's motion relative to the
camera changes smoothly is left.
"""

from __future__ import annotations

import gtsam
import numpy as np

from factors.keys import V, X
from factors.losses import Loss, RobustLoss
from factors.motion import drive_factor, motion_factor
from factors.noise import diagonal_noise, full_noise
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
) -> list[gtsam.NonlinearFactor]:
    """The factors between two frames of vehicle 0.

    Args:
        frames: Their numbers.
        step: From the first to the second.
        pose: Of the vehicle in the second, about where it is as unsure as the camera's motion leaves it.
        model: The category's motion.
        share: Of their information that the factors have.
        alike: Whether the velocities in both are of one kind: over the world, or relative to the camera.
    """
    first, second = frames
    if step.camera is None:
        own, walk = SETTINGS.unknown_camera_sigma, np.array(SETTINGS.relative_velocity_walk)
    else:
        across = model.slip if model.wheeled else model.acceleration
        own, walk = SETTINGS.motion_sigma, np.array([model.acceleration, across, model.turning])
    covariance = step.seconds * np.diag(np.array(own) ** 2) + step.carried(pose)
    unsure = full_noise("motion", covariance / share)
    between = motion_factor(X(0, first), V(0, first), X(0, second), step.seconds, unsure, step.camera)
    if not alike:
        return [between]
    noise = diagonal_noise("walk", walk * np.sqrt(step.seconds) / np.sqrt(share))
    return [between, gtsam.BetweenFactorVector(V(0, first), V(0, second), np.zeros(3), noise)]


def velocity_terms(
    frame: int, seconds: float, model: MotionModel, *, known: bool, share: float = 1.0, stands: bool | None = None
) -> list[gtsam.NonlinearFactor]:
    """The factors about the velocity of vehicle 0 in a frame.

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
        return [drive_factor(key, diagonal_noise("velocity", np.array(SETTINGS.velocity_sigma) / root))]
    if stands:
        sigma = np.array([model.standing, model.standing, SETTINGS.standing_turn_rate_rad_per_s]) / np.sqrt(seconds)
        return [gtsam.PriorFactorVector(key, np.zeros(3), diagonal_noise("standing", sigma))]
    drive = drive_factor(key, diagonal_noise("drive", np.array([forward, model.slip, 1.0]) / root), model.radius)
    if stands is not None:
        return [drive]
    still = diagonal_noise("standing", np.array([model.standing, across, turning]) / root)
    standing = gtsam.PriorFactorVector(
        key, np.zeros(3), RobustLoss.of(Loss.CAUCHY, SETTINGS.standing_loss_sigmas * root).wrap(still)
    )
    return [drive, standing]
