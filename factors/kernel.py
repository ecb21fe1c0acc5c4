"""One evaluation of all keypoints per linearisation point.

What costs in a Python factor is numpy's overhead per call, not the arithmetic. `ProjectionKernel` therefore projects
all keypoints at once, with all their Jacobians, and thin factors read their rows; each keypoint keeps a factor, and
with it a robust weight, of its own.

With q = K (R X + t) the homogeneous pixel, P = K R and u = q_0 / q_2, v = q_1 / q_2,

    du/dX      = (P_0 - u P_2) / q_2,          dv/dX      = (P_1 - v P_2) / q_2
    du/domega  = du/dX (-[X]_x),               du/dv      = du/dX         (right perturbation, rotation first)
    du/dlambda = du/dX basis_i,                du/doffset = du/dX
"""

from __future__ import annotations

from dataclasses import dataclass

import gtsam
import numpy as np
from numpy.lib.stride_tricks import as_strided
from numpy.typing import ArrayLike, NDArray

from factors.checks import finite_array
from factors.errors import InvalidInputError
from factors.shape import LinearShape

__all__ = ["MIN_DEPTH", "Projection", "ProjectionKernel"]

MIN_DEPTH = 1e-3
"""Depth in metres below which a point counts as behind the camera; the projection is evaluated at this depth there."""

# Linear map from X to the nine entries of -[X]_x, row by row.
_NEGATIVE_SKEW = -np.cross(np.eye(3)[:, None], np.eye(3)).transpose(2, 1, 0).reshape(9, 3)


@dataclass(slots=True)
class Projection:
    """All keypoints projected at one linearisation point.

    Attributes:
        pixels: (K, 2) pixels; finite also for points behind the camera, where they mean nothing.
        depths: (K,) depths in the camera frame, metres; positive in front.
        jacobian: (K, 2, D) derivative of the pixels with respect to the kernel's variables in the order of its keys;
            None until it is asked for.
    """

    pixels: NDArray[np.float64]
    depths: NDArray[np.float64]
    jacobian: NDArray[np.float64] | None = None


class ProjectionKernel:
    """Projects the keypoints of a `LinearShape` in one frame, once per linearisation point.

    The pose is a variable (given by its key) or a constant. Several kernels, one per frame, may share one shape. The
    last projection is kept and found again by the bytes of the values, so that it cannot be stale; Jacobians are
    computed when first asked for.

    Attributes:
        shape: The keypoints in the object frame.
        camera_matrix: (3, 3) intrinsics [[fx, s, cx], [0, fy, cy], [0, 0, 1]], pixels.
        pose_key: Key of camera_T_object, or None where the pose is a constant.
        keys: Key of the pose if it is a variable, then the shape's keys.
        dims: Their dimensions: 6 (rotation in radians, translation in metres, `Pose3`'s local coordinates), N, 3K.
    """

    __slots__ = (
        "_directions",
        "_directions_at",
        "_homogeneous",
        "_points",
        "_projection",
        "_stamp",
        "camera_matrix",
        "dims",
        "keys",
        "pose_key",
        "shape",
    )

    def __init__(self, shape: LinearShape, camera_matrix: ArrayLike, pose: int | gtsam.Pose3) -> None:
        """Bind shape, camera and pose.

        Args:
            shape: Keypoints in the object frame.
            camera_matrix: (3, 3) upper triangular intrinsics; a skew is allowed.
            pose: Key of camera_T_object, or its fixed value.

        Raises:
            InvalidInputError: The camera matrix has another form, the fixed pose is not finite, or nothing is variable.
        """
        K = finite_array("camera_matrix", camera_matrix, (3, 3))
        if K[0, 0] <= 0 or K[1, 1] <= 0 or K[1, 0] != 0 or K[2].tolist() != [0.0, 0.0, 1.0]:
            raise InvalidInputError("camera_matrix", K.tolist(), "Give [[fx, s, cx], [0, fy, cy], [0, 0, 1]].")
        self.shape = shape
        self.camera_matrix = K
        self.pose_key: int | None = pose if isinstance(pose, int) else None
        self.keys: tuple[int, ...] = shape.keys if self.pose_key is None else (self.pose_key, *shape.keys)
        self.dims: tuple[int, ...] = shape.dims if self.pose_key is None else (6, *shape.dims)
        # How q moves per unit of the pose and of lambda, before (pose variable) or after (pose fixed) P is applied:
        # (3, columns, K), keypoints last so that every operation below runs along contiguous memory.
        basis = shape.basis if shape.coefficients_key is not None else shape.basis[:0]
        directions = basis.transpose(2, 0, 1)
        if isinstance(pose, int):
            self._homogeneous = np.empty((3, 4))
            axes = np.broadcast_to(np.eye(3)[:, :, None], (3, 3, shape.size))
            directions = np.concatenate([np.zeros((3, 3, shape.size)), axes, directions], axis=1)
        else:
            self._homogeneous = K @ finite_array("pose", pose.matrix(), (4, 4))[:3]
            directions = np.tensordot(self._homogeneous[:, :3], directions, axes=1)
        self._directions = np.ascontiguousarray(directions)
        self._directions_at: NDArray[np.float64] | None = None
        self._points: NDArray[np.float64] | None = None
        self._stamp: bytes | None = None
        self._projection = Projection(np.empty((0, 2)), np.empty(0))

    def evaluate(self, values: gtsam.Values, jacobian: bool = False) -> Projection:
        """The projection of all keypoints at the values, with its Jacobian where that is wanted."""
        points = self.shape.points(values)
        if self.pose_key is None:
            if points is not self._points:
                self._project(points)
        else:
            camera_T_object = values.atPose3(self.pose_key).matrix()
            stamp = camera_T_object.tobytes()
            if points is not self._points or stamp != self._stamp:
                self._homogeneous = self.camera_matrix @ camera_T_object[:3]
                self._project(points)
                self._stamp = stamp
        if jacobian and self._projection.jacobian is None:
            self._projection.jacobian = self._differentiate(points)
        return self._projection

    def _project(self, points: NDArray[np.float64]) -> None:
        q = self._homogeneous[:, :3] @ points.T + self._homogeneous[:, 3:]
        pixels = (q[:2] / np.maximum(q[2], MIN_DEPTH)).T
        self._projection = Projection(np.ascontiguousarray(pixels), q[2])
        self._points = points

    def _differentiate(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        directions, P = self._directions, self._homogeneous[:, :3]
        count, columns = len(points), directions.shape[1]
        if self.pose_key is not None:
            if self._directions_at is not points:
                directions[:, :3] = (_NEGATIVE_SKEW @ points.T).reshape(3, 3, count)
                self._directions_at = points
            directions = (P @ directions.reshape(3, -1)).reshape(3, columns, count)
        pixels = self._projection.pixels.T[:, None]
        depths = np.maximum(self._projection.depths, MIN_DEPTH)
        jacobian = np.zeros((count, 2, sum(self.dims)))
        moved = directions[:2] - pixels * directions[2]
        np.divide(moved, depths, out=jacobian.transpose(1, 2, 0)[:, :columns])
        if self.shape.offsets_key is not None:
            # A keypoint moves with its own three offsets alone: the diagonal blocks of the last 3K columns.
            keypoint, row, column = jacobian.strides
            at = jacobian[:, :, columns:]
            diagonal = as_strided(at, (count, 2, 3), (keypoint + 3 * column, row, column))
            diagonal[...] = ((P[:2, :, None] - pixels * P[2, :, None]) / depths).transpose(2, 0, 1)
        return jacobian
