"""A tracker's estimate of one vehicle in one frame."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.reconstruction import Reconstruction
from fgrecon.core.repr import brief_repr


@dataclass(frozen=True, eq=False)
class VehicleEstimate:
    """One vehicle in one frame, by all that a tracker has seen of it.

    Attributes:
        id: Of the vehicle.
        time: Of the frame, seconds.
        reconstruction: Pose in this frame's camera, shape, covariances and status.
        velocity: (3,) of its origin, metres per second: in the world and along its axes where `world_T_object` is
            known, else relative to the camera and along the camera's axes. None in the first frame, and where the
            camera has come to its place in the world in an unknown way.
        velocity_covariance: (3, 3) of it, along the same axes; None where that is, or where it cannot be had.
        turn_rate: Rate of `rotation_y`, radians per second, in the same sense; None where the velocity is.
        facing_probability: How probably the vehicle faces where the pose says, within a quarter turn; NaN where
            it is not known.
        world_T_object: (4, 4) pose in the world, or None where the camera's is not known.
        frames: How many frames of the vehicle it rests on: those of its window, or the past that was smoothed.
    """

    id: int
    time: float
    reconstruction: Reconstruction
    velocity: NDArray[np.float64] | None
    turn_rate: float | None
    facing_probability: float
    world_T_object: NDArray[np.float64] | None = None
    frames: int = 1
    velocity_covariance: NDArray[np.float64] | None = None

    __repr__ = brief_repr

    @property
    def speed(self) -> float | None:
        """Metres per second; None where the velocity is."""
        return None if self.velocity is None else float(np.linalg.norm(self.velocity))

    @property
    def speed_sigma(self) -> float | None:
        """Standard deviation of the speed, metres per second; of what stands the largest of its velocity's.

        None where the velocity's covariance is.
        """
        velocity, covariance, speed = self.velocity, self.velocity_covariance, self.speed
        if velocity is None or covariance is None:
            return None
        variance = velocity @ covariance @ velocity / speed**2 if speed else np.linalg.eigvalsh(covariance)[-1]
        return math.sqrt(variance)
