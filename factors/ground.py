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

__all__ = ["ground_height_factor", "ground_rows", "upright_factor"]


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


def ground_rows(
    normal: NDArray[np.float64], distance: float, rotation: NDArray[np.float64], translation: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Height and lean over the ground, for any number of poses.

    Args:
        normal: (3,) unit normal of the ground in the camera frame.
        distance: Height of the camera, metres.
        rotation: (..., 3, 3) of camera_T_object.
        translation: (..., 3) of camera_T_object, metres.

    Returns:
        (..., 4) residual: height in metres, lean; and (..., 4, 3) its derivative by a turn about the object's axes:
        d(R exp(w) e_y) = R (w x e_y) = R (-w_z, 0, w_x). By the translation that of the height is the normal, that of
        the lean zero.
    """
    residual = np.empty((*translation.shape[:-1], 4))
    residual[..., 0] = translation @ normal - distance
    residual[..., 1:] = rotation[..., 1] - normal
    by_turn = np.zeros((*translation.shape[:-1], 4, 3))
    by_turn[..., 1:, 0] = rotation[..., 2]
    by_turn[..., 1:, 2] = -rotation[..., 0]
    return residual, by_turn


@dataclass(frozen=True, slots=True)
class _Height:
    pose_key: int
    normal: NDArray[np.float64]
    distance: float

    def __call__(self, values: gtsam.Values, want_jacobian: bool) -> Evaluation:
        pose = values.atPose3(self.pose_key).matrix()
        residual, by_turn = ground_rows(self.normal, self.distance, pose[:3, :3], pose[:3, 3])
        if not want_jacobian:
            return residual[:1], None
        return residual[:1], np.concatenate([by_turn[0], self.normal @ pose[:3, :3]])[None]


@dataclass(frozen=True, slots=True)
class _Upright:
    pose_key: int
    normal: NDArray[np.float64]

    def __call__(self, values: gtsam.Values, want_jacobian: bool) -> Evaluation:
        pose = values.atPose3(self.pose_key).matrix()
        residual, by_turn = ground_rows(self.normal, 0.0, pose[:3, :3], pose[:3, 3])
        if not want_jacobian:
            return residual[1:], None
        return residual[1:], np.hstack([by_turn[1:], np.zeros((3, 3))])
