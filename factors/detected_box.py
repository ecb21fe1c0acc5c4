"""Pose prior from another detector's 3D box: direction, distance and yaw.

    r = ( x/z - x0/z0,  y/z - y0/z0,  log(z / z0) )     the origin, 3 rows: tangents of angles, and a ratio
    r = yaw - yaw0, modulo half a turn                  the yaw, 1 row: radians

Detectors know far better in which direction a vehicle is than how far it is, and err in the distance by a share of it:
in these coordinates their errors are of one size near and far. Some boxes are flipped, so that the yaw has two
modes of one width. Which of them is meant is decided by all that is known of the facing, not by a solver's steps, and
this factor has the same energy at both.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import gtsam
import numpy as np
from numpy.typing import ArrayLike, NDArray

from factors.checks import finite_array
from factors.errors import InvalidInputError
from factors.guard import Evaluation, guarded_factor
from factors.noise import Noise

_NEAREST = 1e-3  # metres; nearer, the direction of an origin means nothing


def detected_origin_factor(pose_key: int, origin: ArrayLike, noise: Noise) -> gtsam.CustomFactor:
    """The object's origin is where a detector saw it: 3 rows, tangents across and down, logarithm of the depth.

    Args:
        pose_key: Key of camera_T_object.
        origin: (3,) the detected origin in the camera frame, metres, in front of the camera.
        noise: Noise model of dimension 3.

    Raises:
        InvalidInputError: The origin is not finite or not in front of the camera, or the noise has another dimension.
    """
    detected = finite_array("origin", origin, (3,))
    if detected[2] <= _NEAREST:
        raise InvalidInputError("origin", detected.tolist(), "Give an origin in front of the camera (z > 0).")
    return guarded_factor("detected origin", noise, (pose_key,), (6,), 3, _Origin(pose_key, detected))


def detected_yaw_factor(pose_key: int, yaw: float, noise: Noise) -> gtsam.CustomFactor:
    """The object's yaw is the detected one, or half a turn off: 1 row, radians from -pi / 2 to pi / 2.

    Args:
        pose_key: Key of camera_T_object.
        yaw: The detected yaw about the camera's y axis, radians.
        noise: Noise model of dimension 1, or sigma in radians.

    Raises:
        InvalidInputError: The yaw is not finite, or the noise has another dimension.
    """
    callback = _Yaw(pose_key, float(finite_array("yaw", yaw, ())))
    return guarded_factor("detected yaw", noise, (pose_key,), (6,), 1, callback)


@dataclass(frozen=True, slots=True)
class _Origin:
    pose_key: int
    origin: NDArray[np.float64]

    def __call__(self, values: gtsam.Values, want_jacobian: bool) -> Evaluation:
        pose = values.atPose3(self.pose_key).matrix()
        x, y, z = pose[:3, 3].tolist()
        z = max(z, _NEAREST)
        x0, y0, z0 = self.origin.tolist()
        residual = np.array([x / z - x0 / z0, y / z - y0 / z0, math.log(z / z0)])
        if not want_jacobian:
            return residual, None
        by_place = np.array([[1.0 / z, 0.0, -x / z**2], [0.0, 1.0 / z, -y / z**2], [0.0, 0.0, 1.0 / z]])
        jacobian = np.zeros((3, 6))
        jacobian[:, 3:] = by_place @ pose[:3, :3]
        return residual, jacobian


@dataclass(frozen=True, slots=True)
class _Yaw:
    pose_key: int
    yaw: float

    def __call__(self, values: gtsam.Values, want_jacobian: bool) -> Evaluation:
        rotation = values.atPose3(self.pose_key).matrix()[:3, :3]
        ahead, along = float(rotation[0, 0]), float(rotation[2, 0])
        residual = np.array([math.remainder(math.atan2(-along, ahead) - self.yaw, math.pi)])
        if not want_jacobian:
            return residual, None
        # The forward axis R e_x turns by R (w x e_x) = w_z R e_y - w_y R e_z.
        length = max(ahead**2 + along**2, _NEAREST**2)
        across = np.array([along, -ahead]) / length  # of the yaw by the axis' x and z
        jacobian = np.zeros((1, 6))
        jacobian[0, 1:3] = across @ np.stack([-rotation[[0, 2], 2], rotation[[0, 2], 1]], axis=1)
        return residual, jacobian
