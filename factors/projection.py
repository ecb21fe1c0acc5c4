"""Projection of points and its derivatives, for many poses at once: the energy that proposals and factors share.

With X a point of the object frame, Y = R X + t in the camera frame and (u, v) its pixel,

    d(u, v)/dY = [[fx, s, -(fx x + s y)], [0, fy, -fy y]] / z        with x = X / Z, y = Y / Z of the camera point
    d(u, v)/domega = d(u, v)/dY R (-[X]_x),    d(u, v)/dt = d(u, v)/dY,    d(u, v)/dlambda_i = d(u, v)/dY R basis_i

omega is a turn about the object's own axes. The translation is the camera frame's; GTSAM's `Pose3` moves along the
object's axes instead, whose derivative is d(u, v)/dY R. Functions take H poses at once; a factor has one.
"""

from __future__ import annotations

import numpy as np

from factors.arrays import Array

LEAST_DEPTH = 1e-3
"""Depth in metres below which a point counts as behind the camera; the projection is evaluated at this depth there."""

SHALLOWEST = 10 * LEAST_DEPTH
"""The barrier's depth in metres: it keeps every keypoint of a vehicle deeper, where the projection is the true one."""


def project(
    matrix: Array, rotation: Array, translation: Array, points: Array, min_depth: float = LEAST_DEPTH
) -> tuple[Array, Array, Array]:
    """Project points.

    Args:
        matrix: (3, 3) intrinsics.
        rotation: (..., 3, 3) of camera_T_object.
        translation: (..., 3) of camera_T_object, metres.
        points: (..., P, 3) in the object frame, metres.
        min_depth: Smallest depth that is evaluated, metres.

    Returns:
        (..., P, 2) pixels; (..., P, 3) points in the camera frame, at least that deep; (..., P) their true depths.
    """
    camera = points @ np.swapaxes(rotation, -1, -2) + translation[..., None, :]
    depths = camera[..., 2].copy()
    np.maximum(depths, min_depth, out=camera[..., 2])
    homogeneous = camera @ matrix.T
    return homogeneous[..., :2] / homogeneous[..., 2:], camera, depths


def pixel_jacobian(matrix: Array, camera: Array) -> Array:
    """(..., 2, 3) derivative of the pixel with respect to the camera point (..., 3)."""
    inverse = 1.0 / camera[..., 2]
    x, y = camera[..., 0] * inverse, camera[..., 1] * inverse
    result = np.zeros((*camera.shape[:-1], 2, 3))
    result[..., 0, 0] = matrix[0, 0] * inverse
    result[..., 0, 1] = matrix[0, 1] * inverse
    result[..., 1, 1] = matrix[1, 1] * inverse
    result[..., 0, 2] = -(matrix[0, 0] * x + matrix[0, 1] * y) * inverse
    result[..., 1, 2] = -matrix[1, 1] * y * inverse
    return result


def by_pose(points: Array, rotation: Array, by_camera: Array) -> tuple[Array, Array]:
    """Chain a derivative by the camera points to the turn and to the object points.

    Args:
        points: (..., P, 3) in the object frame.
        rotation: (..., 3, 3) of camera_T_object.
        by_camera: (..., P, R, 3) derivative of R numbers of each point by it, in the camera frame.

    Returns:
        (..., P, R, 3) derivatives by a turn about the object's own axes, and by the point in the object frame.
    """
    shape = by_camera.shape
    by_object: Array = (by_camera.reshape(*shape[:-3], -1, 3) @ rotation).reshape(shape)
    return cross(points[..., None, :], by_object), by_object


def cross(a: Array, b: Array) -> Array:
    """Cross product along the last axis, without the overhead of numpy's general one."""
    result = np.empty(np.broadcast_shapes(a.shape, b.shape))
    result[..., 0] = a[..., 1] * b[..., 2] - a[..., 2] * b[..., 1]
    result[..., 1] = a[..., 2] * b[..., 0] - a[..., 0] * b[..., 2]
    result[..., 2] = a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
    return result
