"""Motion model from one image to the next: constant velocity and turn rate, and what a wheeled vehicle can do.

    X(v,t) ---+--- motion (6) ---+--- X(v,t')
              |                  |
    V(v,t) ---+--- random walk --+--- V(v,t')
       |
     drive (3): slip, turning circle, standing

V(v,t) = (forward, left, turn rate) is the vehicle's velocity along its own axes x and z, metres per second, and its
rotation about its own down axis, radians per second (the rate of `rotation_y`), over a world that stands still. After
dt seconds, camera_now_T_camera_next being the camera's own motion in the meantime, the pose X' should be

    camera_now_T_camera_next^-1  X  exp(dt xi),    xi = (0, turn rate, 0; forward, 0, left)

With a camera that is taken to stand, though it moves, V is the velocity relative to it.
"""

from __future__ import annotations

from dataclasses import dataclass

import gtsam
import numpy as np
from numpy.typing import ArrayLike

from factors.checks import finite_array
from factors.errors import InvalidInputError
from factors.guard import CompiledRows, Evaluation, guarded_factor
from factors.native import native
from factors.noise import Noise

_TWIST = np.zeros((6, 3))
_TWIST[3, 0] = _TWIST[5, 1] = _TWIST[1, 2] = 1.0
_CRAWL = 1.0  # metres per second by which the turning circle's limit is rounded off at standstill


def moved(pose: gtsam.Pose3, velocity: ArrayLike, seconds: float, camera_motion: gtsam.Pose3) -> gtsam.Pose3:
    """The pose camera_T_object after some time.

    Args:
        pose: The pose now.
        velocity: (3,) forward, left, turn rate.
        seconds: The time.
        camera_motion: camera_now_T_camera_then.
    """
    twist = seconds * (_TWIST @ np.asarray(velocity, dtype=np.float64))
    return camera_motion.inverse().compose(pose).compose(gtsam.Pose3.Expmap(twist))


def motion_factor(
    pose_key: int,
    velocity_key: int,
    next_key: int,
    seconds: float,
    noise: Noise,
    camera_motion: gtsam.Pose3 | None = None,
) -> gtsam.CustomFactor:
    """The next pose is where velocity and turn rate lead: 6 rows, radians and metres in the vehicle's own frame.

    Args:
        pose_key: Key of camera_T_object now.
        velocity_key: Key of the velocity (3,) now.
        next_key: Key of camera_T_object in the next image.
        seconds: Time from this image to the next, above zero.
        noise: Noise model of dimension 6: rotation, translation.
        camera_motion: camera_now_T_camera_next; None for a camera that stands.

    Raises:
        InvalidInputError: The time is not above zero, or the noise model has another dimension.
    """
    step = float(finite_array("motion.seconds", seconds, ()))
    if step <= 0.0:
        raise InvalidInputError("motion.seconds", seconds, "Give images in the order of time.")
    camera = gtsam.Pose3() if camera_motion is None else camera_motion
    keys, kernel = (pose_key, velocity_key, next_key), native("factors._rows")
    compiled = None if kernel is None else CompiledRows(kernel.Motion(step, camera.matrix()), keys)
    return guarded_factor("motion", noise, keys, (6, 3, 6), 6, _Motion(*keys, step, camera), compiled=compiled)


def drive_factor(velocity_key: int, noise: Noise, least_radius: float | None = None) -> gtsam.CustomFactor:
    """What velocities a vehicle has: 3 rows, forward and left in metres per second, and the turn rate.

    With a turning circle the third row is the turn rate as a share of what the circle allows at this speed (without
    unit); it has a vehicle that stands turn slowly at most. A robust noise model lets a vehicle stand or drive.

    Args:
        velocity_key: Key of the velocity (3,).
        noise: Noise model of dimension 3.
        least_radius: Radius of the turning circle, metres; None where there is none.

    Raises:
        InvalidInputError: The radius is not above zero, or the noise model has another dimension.
    """
    if least_radius is not None and not float(finite_array("drive.least_radius", least_radius, ())) > 0.0:
        raise InvalidInputError("drive.least_radius", least_radius, "Give a radius above zero, or None.")
    kernel, compiled = native("factors._rows"), None
    if kernel is not None:
        compiled = CompiledRows(kernel.Drive(least_radius or np.nan, _CRAWL), (velocity_key,))
    callback = _Drive(velocity_key, least_radius)
    return guarded_factor("drive", noise, (velocity_key,), (3,), 3, callback, compiled=compiled)


@dataclass(frozen=True, slots=True)
class _Motion:
    pose_key: int
    velocity_key: int
    next_key: int
    seconds: float
    camera: gtsam.Pose3

    def __call__(self, values: gtsam.Values, want_jacobian: bool) -> Evaluation:
        twist = self.seconds * (_TWIST @ values.atVector(self.velocity_key))
        between = values.atPose3(self.pose_key).inverse().compose(self.camera.compose(values.atPose3(self.next_key)))
        off = gtsam.Pose3.Expmap(-twist).compose(between)
        residual = np.asarray(gtsam.Pose3.Logmap(off))
        if not want_jacobian:
            return residual, None
        by_off = gtsam.Pose3.LogmapDerivative(off)
        jacobian = np.empty((6, 15))
        jacobian[:, :6] = -by_off @ between.inverse().AdjointMap()
        by_twist = gtsam.Pose3.ExpmapDerivative(twist) @ _TWIST
        jacobian[:, 6:9] = -self.seconds * (by_off @ off.inverse().AdjointMap() @ by_twist)
        jacobian[:, 9:] = by_off
        return residual, jacobian


@dataclass(frozen=True, slots=True)
class _Drive:
    velocity_key: int
    least_radius: float | None

    def __call__(self, values: gtsam.Values, want_jacobian: bool) -> Evaluation:
        velocity = values.atVector(self.velocity_key)
        residual, jacobian = velocity.copy(), np.eye(3) if want_jacobian else None
        if self.least_radius is not None:
            speed = float(np.hypot(velocity[0], _CRAWL))
            share = self.least_radius / speed
            residual[2] = velocity[2] * share
            if jacobian is not None:
                jacobian[2, 2] = share
                jacobian[2, 0] = -residual[2] * velocity[0] / speed**2
        return residual, jacobian
