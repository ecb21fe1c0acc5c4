"""The ground plane as evidence about the pose: height of the origin, and uprightness.

The ground is the plane normal . x = distance of the camera frame, its normal pointing down; the object's origin lies on
it and its y axis points into it. Not in the paper, whose poses come from boxes; both factors are unary on the pose, so
that a graph over many frames adds one of each per frame.
"""

from __future__ import annotations

from dataclasses import dataclass

import gtsam
import numpy as np
from numpy.typing import ArrayLike, NDArray

from factors.checks import finite_array, unit_vector
from factors.guard import Evaluation, guarded_factor
from factors.noise import Noise

__all__ = ["ground_height_factor", "upright_factor"]

# d(R e_y) / d omega = -R [e_y]_x
_NEGATIVE_SKEW_Y = -np.array([[0.0, 0.0, 1.0], [0.0, 0.0, 0.0], [-1.0, 0.0, 0.0]])


def ground_height_factor(pose_key: int, normal: ArrayLike, distance: float, noise: Noise) -> gtsam.CustomFactor:
    """The object's origin lies on the ground: r = normal . t - distance, 1 row, metres.

    Args:
        pose_key: Key of camera_T_object.
        normal: (3,) normal of the ground in the camera frame, pointing down; scaled to length 1.
        distance: Height of the camera above the ground, metres.
        noise: Noise model of dimension 1, or sigma in metres.

    Raises:
        InvalidInputError: The normal has no length or a number is not finite.
    """
    callback = _Height(pose_key, unit_vector("normal", normal), float(finite_array("distance", distance, ())))
    return guarded_factor("ground height", noise, (pose_key,), (6,), 1, callback)


def upright_factor(pose_key: int, normal: ArrayLike, noise: Noise) -> gtsam.CustomFactor:
    """The object's down axis is the ground's normal: r = R e_y - normal, 3 rows.

    The chord between two unit vectors at an angle a is 2 sin(a / 2) long: the lean in radians where it is small. To
    first order it equals the two coordinates in the tangent plane of the normal; but those vanish again for a vehicle
    upside down, where the chord is longest, and the chord is smooth everywhere.

    Args:
        pose_key: Key of camera_T_object.
        normal: (3,) normal of the ground in the camera frame, pointing down; scaled to length 1.
        noise: Noise model of dimension 3, or sigma in radians.

    Raises:
        InvalidInputError: The normal has no length or is not finite.
    """
    return guarded_factor("upright", noise, (pose_key,), (6,), 3, _Upright(pose_key, unit_vector("normal", normal)))


@dataclass(frozen=True, slots=True)
class _Height:
    pose_key: int
    normal: NDArray[np.float64]
    distance: float

    def __call__(self, values: gtsam.Values, want_jacobian: bool) -> Evaluation:
        camera_T_object = values.atPose3(self.pose_key).matrix()
        residual = np.array([self.normal @ camera_T_object[:3, 3] - self.distance])
        if not want_jacobian:
            return residual, None
        jacobian = np.zeros((1, 6))
        jacobian[0, 3:] = self.normal @ camera_T_object[:3, :3]
        return residual, jacobian


@dataclass(frozen=True, slots=True)
class _Upright:
    pose_key: int
    normal: NDArray[np.float64]

    def __call__(self, values: gtsam.Values, want_jacobian: bool) -> Evaluation:
        R = values.atPose3(self.pose_key).matrix()[:3, :3]
        residual = R[:, 1] - self.normal
        if not want_jacobian:
            return residual, None
        jacobian = np.zeros((3, 6))
        jacobian[:, :3] = R @ _NEGATIVE_SKEW_Y
        return residual, jacobian
