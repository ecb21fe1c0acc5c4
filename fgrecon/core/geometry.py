"""Small vectorised geometry that several parts share."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from factors.projection import cross, pixel_jacobian
from fgrecon.core.arrays import Array

__all__ = [
    "AHEAD",
    "FORWARD_LEFT_UP",
    "MIRROR",
    "box_around",
    "cross",
    "exponential",
    "pixel_jacobian",
    "position_covariance",
    "quaternion_pose",
    "rigid",
    "transform",
    "turn_between",
    "view_azimuth",
    "yaw_rotation",
]


MIRROR = np.array([1.0, 1.0, -1.0])
"""Factors of the coordinates in the object frame that put a point where its mirror image is."""


FORWARD_LEFT_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
"""From axes x forward, y left, z up, as robots and most data sets have them, to the object frame."""

UPRIGHT = float(np.cos(np.radians(30.0)))  # cosine to which a z axis points up: a mounted camera leans by less
AHEAD = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
"""From a camera's axes right, down, forward to axes forward, left, up."""


def exponential(rotation: Array) -> Array:
    """(..., 3, 3) rotation matrices of rotation vectors (..., 3) (Rodrigues)."""
    angle = np.sqrt(np.square(rotation).sum(axis=-1))[..., None, None]
    x, y, z = rotation[..., 0], rotation[..., 1], rotation[..., 2]
    zero = np.zeros_like(x)
    skew = np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=-1).reshape(*rotation.shape[:-1], 3, 3)
    safe = np.maximum(angle, 1e-8)
    return np.eye(3) + np.sin(safe) / safe * skew + (1.0 - np.cos(safe)) / safe**2 * (skew @ skew)


def yaw_rotation(yaw: ArrayLike) -> Array:
    """(..., 3, 3) rotations about the camera's y axis by angles (...), radians."""
    angle = np.asarray(yaw, dtype=np.float64)
    cosine, sine = np.cos(angle), np.sin(angle)
    rotation = np.zeros((*angle.shape, 3, 3))
    rotation[..., 0, 0] = rotation[..., 2, 2] = cosine
    rotation[..., 0, 2], rotation[..., 2, 0] = sine, -sine
    rotation[..., 1, 1] = 1.0
    return rotation


def view_azimuth(rotation: Array, translation: Array) -> Array:
    """(...) directions from vehicles to the camera about their vertical axis, radians; 0 ahead, pi / 2 to their left.

    Args:
        rotation: (..., 3, 3) of camera_T_object.
        translation: (..., 3) of it.
    """
    position = -np.einsum("...ij,...i->...j", rotation, translation)
    return np.arctan2(position[..., 2], position[..., 0])


def position_covariance(camera_T_object: Array, pose_covariance: Array) -> Array:
    """(3, 3) covariance of the origin in the camera frame, of that (6, 6) of the pose in GTSAM's order and frame."""
    rotation = camera_T_object[:3, :3]
    return rotation @ pose_covariance[3:, 3:] @ rotation.T


def rigid(rotation: ArrayLike, place: ArrayLike) -> Array:
    """(4, 4) pose of a rotation (3, 3) and a place (3,)."""
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, place
    return pose


def quaternion_pose(quaternion: Array, place: Array) -> Array:
    """(4, 4) pose of a quaternion w, x, y, z of about unit length and a place (3,)."""
    w, x, y, z = quaternion / np.linalg.norm(quaternion)
    rotation = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return rigid(rotation, place)


def transform(a_T_b: Array, points: Array) -> Array:
    """Points (..., 3) of frame b in frame a, by the pose (4, 4)."""
    return points @ a_T_b[:3, :3].T + a_T_b[:3, 3]


def turn_between(first: Array, second: Array) -> float:
    """Angle between two rotations (3, 3), or those of two poses (4, 4), radians."""
    cosine = (np.trace(first[:3, :3].T @ second[:3, :3]) - 1.0) / 2.0
    return float(np.arccos(np.clip(cosine, -1.0, 1.0)))


def box_around(points: Array) -> Array:
    """(4,) x1, y1, x2, y2 of the smallest upright box around points (n, 2)."""
    return np.concatenate([points.min(axis=0), points.max(axis=0)])


def box_overlaps(first: Array, second: Array) -> Array:
    """(M, N) intersection over union of boxes (M, 4) and (N, 4), x1, y1, x2, y2."""
    low = np.maximum(first[:, None, :2], second[None, :, :2])
    high = np.minimum(first[:, None, 2:], second[None, :, 2:])
    common = np.clip(high - low, 0.0, None).prod(axis=2)
    areas = [(boxes[:, 2:] - boxes[:, :2]).prod(axis=1) for boxes in (first, second)]
    union = areas[0][:, None] + areas[1][None] - common
    return np.asarray(common / np.maximum(union, 1e-9))
