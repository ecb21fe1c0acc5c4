"""Keypoint projections and derivatives, evaluated once per linearisation point.

What costs in a Python factor is numpy's overhead per call, not the arithmetic. `ProjectionKernel` therefore projects
all keypoints at once, with all their Jacobians, for one factor that has all that an image says of a vehicle
(`factors.observation_rows`).

The equations are those of `factors.projection`, which the search for proposals evaluates for many poses at once.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import gtsam
import numpy as np
from numpy.lib.stride_tricks import as_strided
from numpy.typing import ArrayLike

from factors.arrays import Array
from factors.checks import finite_array
from factors.errors import InvalidInputError
from factors.projection import by_pose, pixel_jacobian, project
from factors.shape import LinearShape


@dataclass(slots=True)
class Projection:
    """All keypoints projected at one linearisation point.

    Attributes:
        pixels: (K, 2) pixels; finite also for points behind the camera, where they mean nothing.
        depths: (K,) depths in the camera frame, metres; positive in front.
        camera: (K, 3) points in the camera frame, metres, at least `LEAST_DEPTH` of `factors.projection` deep.
        points: (K, 3) points in the object frame, metres.
        rotation: (3, 3) of camera_T_object.
        matrix: (3, 3) intrinsics.
        jacobian: (K, 2, D) derivative of the pixels with respect to the kernel's variables in the order of its keys;
            None until it is asked for.
    """

    pixels: Array
    depths: Array
    camera: Array
    points: Array
    rotation: Array
    matrix: Array
    jacobian: Array | None = None


class ProjectionKernel:
    """Projects the keypoints of a `LinearShape` in one frame, once per linearisation point.

    The pose is a variable (given by its key) or a constant. Several kernels, one per frame, may share one shape, and
    several a focal length that is a variable: q, which makes both focal lengths and the skew exp(q) times the nominal
    ones, with d(u, v)/dq = (u - cx, v - cy). The last projection is kept and found again by the bytes of the values, so
    that it cannot be stale; Jacobians are computed when first asked for.

    Attributes:
        shape: The keypoints in the object frame.
        camera_matrix: (3, 3) nominal intrinsics [[fx, s, cx], [0, fy, cy], [0, 0, 1]], pixels.
        pose_key: Key of camera_T_object, or None where the pose is a constant.
        focal_key: Key of the focal length q, or None where the camera is a constant.
        keys: Key of the pose if it is a variable, then the shape's keys, then that of the focal length.
        dims: Their dimensions: 6 (rotation in radians, translation in metres, `Pose3`'s local coordinates), N, 3K, 1.
    """

    def __init__(
        self, shape: LinearShape, camera_matrix: ArrayLike, pose: int | gtsam.Pose3, focal: int | None = None
    ) -> None:
        """Bind shape, camera and pose.

        Args:
            shape: Keypoints in the object frame.
            camera_matrix: (3, 3) upper triangular intrinsics; a skew is allowed.
            pose: Key of camera_T_object, or its fixed value.
            focal: Key of the focal length; None where it is that of the camera matrix.

        Raises:
            InvalidInputError: The camera matrix has another form, the fixed pose is not finite, or nothing is variable.
        """
        K = finite_array("camera_matrix", camera_matrix, (3, 3))
        if K[0, 0] <= 0 or K[1, 1] <= 0 or K[1, 0] != 0 or K[2].tolist() != [0.0, 0.0, 1.0]:
            raise InvalidInputError("camera_matrix", K.tolist(), "Give [[fx, s, cx], [0, fy, cy], [0, 0, 1]].")
        self.shape = shape
        self.camera_matrix = K
        self.pose_key: int | None = pose if isinstance(pose, int) else None
        self.focal_key = focal
        self.keys: tuple[int, ...] = shape.keys if self.pose_key is None else (self.pose_key, *shape.keys)
        self.dims: tuple[int, ...] = shape.dims if self.pose_key is None else (6, *shape.dims)
        if focal is not None:
            self.keys, self.dims = (*self.keys, focal), (*self.dims, 1)
        basis = shape.basis if shape.coefficients_key is not None else shape.basis[:0]
        self._basis = np.ascontiguousarray(basis.transpose(1, 2, 0))
        self._pose: Array | None = None
        if not isinstance(pose, int):
            self._pose = finite_array("pose", pose.matrix(), (4, 4))
        self._last: tuple[bytes | None, Projection | None] = None, None  # in one: see `LinearShape`

    def evaluate(self, values: gtsam.Values, jacobian: bool = False) -> Projection:
        """The projection of all keypoints at the values, with its Jacobian where that is wanted."""
        points, pose, matrix = self.shape.points(values), self.pose(values), self.matrix(values)
        (before, last), stamp = self._last, pose.tobytes()
        if last is None or points is not last.points or stamp != before or matrix[0, 0] != last.matrix[0, 0]:
            rotation = pose[:3, :3]
            pixels, camera, depths = project(matrix, rotation, pose[:3, 3], points)
            last = Projection(pixels, depths, camera, points, rotation, matrix)
        if jacobian and last.jacobian is None:
            last.jacobian = self._differentiate(last)
        self._last = stamp, last
        return last

    @property
    def bound(self) -> int | Array:
        """The pose's key, or (4, 4) where it is a constant."""
        if self.pose_key is not None:
            return self.pose_key
        assert self._pose is not None
        return self._pose

    def pose(self, values: gtsam.Values) -> Array:
        """(4, 4) camera_T_object at the values."""
        if self.pose_key is None:
            assert self._pose is not None
            return self._pose
        return values.atPose3(self.pose_key).matrix()

    def matrix(self, values: gtsam.Values) -> Array:
        """(3, 3) intrinsics at the values."""
        if self.focal_key is None:
            return self.camera_matrix
        matrix = self.camera_matrix.copy()
        matrix[:2, :2] *= math.exp(values.atVector(self.focal_key)[0])
        return matrix

    def _differentiate(self, at: Projection) -> Array:
        by_camera = pixel_jacobian(at.matrix, at.camera)
        by_turn, by_object = by_pose(at.points, at.rotation, by_camera)
        blocks = [by_object @ self._basis] if self.shape.coefficients_key is not None else []
        if self.pose_key is not None:
            blocks = [by_turn, by_object, *blocks]
        by_focal = [] if self.focal_key is None else [(at.pixels - at.matrix[:2, 2])[..., None]]
        if self.shape.offsets_key is None:
            return np.concatenate([*blocks, *by_focal], axis=-1)
        count = len(at.points)
        columns = sum(block.shape[-1] for block in blocks)
        jacobian = np.zeros((count, 2, sum(self.dims)))
        if blocks:
            np.concatenate(blocks, axis=-1, out=jacobian[:, :, :columns])
        if by_focal:
            jacobian[:, :, -1:] = by_focal[0]
        # A keypoint moves with its own three offsets alone: the diagonal blocks of the 3K columns after.
        keypoint, row, column = jacobian.strides
        diagonal = as_strided(jacobian[:, :, columns:], (count, 2, 3), (keypoint + 3 * column, row, column))
        diagonal[...] = by_object
        return jacobian
