"""The motion factors between two frames of one vehicle, and about its velocity in one.

Where the camera's own motion is known they are those of the category; else only that a vehicle's motion relative to the
camera changes smoothly is left.
"""

from __future__ import annotations

import gtsam
import numpy as np
from numpy.typing import NDArray

from factors.keys import V, X
from factors.losses import Loss, RobustLoss
from factors.motion import drive_factor, motion_factor
from factors.noise import diagonal_noise, full_noise
from fgrecon.core.motion import MotionModel

__all__ = ["link", "velocity_terms"]

Array = NDArray[np.float64]

_OWN = np.array([0.02, 0.05, 0.02, 0.2, 0.1, 0.1])
"""What constant velocity and turn rate miss in a second (1 sigma): radians and metres, along the vehicle's axes."""
_UNKNOWN = np.array([0.1, 0.1, 0.1, 0.5, 0.5, 0.5])
"""The same where the camera moves in an unknown way: it pitches, and the velocity relative to it turns."""
_RELATIVE = np.array([4.0, 4.0, 0.5])
"""By how much a velocity relative to a moving camera changes in a second."""
_STANDS = 2.0  # standard deviations from which on a vehicle drives; scaled as its noise is, the loss is
_STILL_TURN = 0.02  # radians per second: how fast what stands seems to turn
_FASTEST = np.array([30.0, 30.0, 1.0])  # metres per second, and radians per second


def link(
    frames: tuple[int, int],
    seconds: float,
    model: MotionModel,
    camera_motion: gtsam.Pose3 | None,
    *,
    carried: Array | None = None,
    share: float = 1.0,
    alike: bool = True,
) -> list[gtsam.NonlinearFactor]:
    """The factors between two frames of vehicle 0.

    Args:
        frames: Their numbers.
        seconds: Between them.
        model: The category's motion.
        camera_motion: camera_first_T_camera_second, or None where it is unknown.
        carried: (6, 6) covariance of the second pose, in the vehicle's own frame, by what is not known of the camera's
            motion; None where it is exact.
        share: Of their information that the factors have.
        alike: Whether the velocities in both are of one kind: over the world, or relative to the camera.
    """
    first, second = frames
    if camera_motion is not None and model.wheeled:
        own, walk = _OWN, np.array([model.acceleration, model.slip, model.turning])
    elif camera_motion is not None:
        own, walk = _OWN, np.array([model.acceleration, model.acceleration, model.turning])
    else:
        own, walk = _UNKNOWN, _RELATIVE
    covariance = seconds * np.diag(own**2) + (0.0 if carried is None else carried)
    unsure = full_noise("motion", covariance / share)
    between = motion_factor(X(0, first), V(0, first), X(0, second), seconds, unsure, camera_motion)
    if not alike:
        return [between]
    root = np.sqrt(share)
    noise = diagonal_noise("walk", walk * np.sqrt(seconds) / root)
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
        share: Of their information that the factors have; that it stands, where that is told, counts whole.
        stands: Whether it stands; None where it may.
    """
    root = np.sqrt(share * seconds)
    key = V(0, frame)
    if not known or not model.wheeled:
        return [drive_factor(key, diagonal_noise("velocity", _FASTEST / root))]
    if stands:
        sigma = np.array([model.standing, model.standing, _STILL_TURN]) / np.sqrt(seconds)
        return [gtsam.PriorFactorVector(key, np.zeros(3), diagonal_noise("standing", sigma))]
    drive = drive_factor(key, diagonal_noise("drive", np.array([_FASTEST[0], model.slip, 1.0]) / root), model.radius)
    if stands is not None:
        return [drive]
    still = diagonal_noise("standing", np.array([model.standing, _FASTEST[1], _FASTEST[2]]) / root)
    standing = gtsam.PriorFactorVector(key, np.zeros(3), RobustLoss.of(Loss.CAUCHY, _STANDS * root).wrap(still))
    return [drive, standing]
