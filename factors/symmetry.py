"""Mirror symmetry about the medial plane: E_sym of the paper's section III-C, in metres.

    r = X_r - 2 (n'X_r + d) n - X_l    for each pair (left, right)
    r = n'X + d                        for each keypoint on the medial plane

The paper prints + 2 (d - n'X_r) n, which is the same for a plane n'X = d; here planes are n'X + d = 0 everywhere. With
a prior that is exactly symmetric and without free offsets the term vanishes for every lambda.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import gtsam
import numpy as np
from numpy.typing import ArrayLike, NDArray

from factors.checks import index_array
from factors.errors import InvalidInputError
from factors.guard import Evaluation, guarded_factor
from factors.noise import Noise
from factors.planes import plane_at
from factors.shape import LinearShape

__all__ = ["symmetry_factor"]


def symmetry_factor(
    shape: LinearShape,
    pairs: Sequence[tuple[int, int]],
    plane_key: int,
    noise: Noise,
    *,
    on_plane: ArrayLike = (),
) -> gtsam.CustomFactor:
    """Pairs of keypoints mirror each other: 3 rows per pair, then one per keypoint on the plane, metres.

    Args:
        shape: The keypoints.
        pairs: Pairs (left, right) of mirror images.
        plane_key: Key of the medial plane, an `OrientedPlane3`.
        noise: Noise model of that many rows, or sigma in metres.
        on_plane: Keypoints that are their own mirror image.

    Raises:
        InvalidInputError: There are no pairs, or an index is out of range or repeated.
    """
    array = np.asarray(pairs)
    if array.ndim != 2 or array.shape[1] != 2:
        raise InvalidInputError("pairs", pairs, "Give at least one pair (left, right).")
    middle = np.asarray(on_plane, dtype=np.intp if not np.size(on_plane) else None)
    index_array("pairs", np.concatenate([array.ravel(), middle]), shape.size)
    left, right = array.T
    callback = _Symmetry(
        shape,
        left,
        right,
        middle,
        shape.derivative[left],
        shape.derivative[right],
        shape.derivative[middle],
        plane_key,
    )
    rows = 3 * len(left) + len(middle)
    return guarded_factor("symmetry", noise, (*shape.keys, plane_key), (*shape.dims, 3), rows, callback)


@dataclass(frozen=True, slots=True)
class _Symmetry:
    """Holds the indices of P pairs and Q keypoints in the middle, and the derivatives (P or Q, 3, D) of each group."""

    shape: LinearShape
    left: NDArray[np.intp]
    right: NDArray[np.intp]
    middle: NDArray[np.intp]
    left_derivative: NDArray[np.float64]
    right_derivative: NDArray[np.float64]
    middle_derivative: NDArray[np.float64]
    plane_key: int

    def __call__(self, values: gtsam.Values, want_jacobian: bool) -> Evaluation:
        points = self.shape.points(values)
        normal, d, basis = plane_at(values, self.plane_key)
        right, middle = points[self.right], points[self.middle]
        distance = right @ normal + d
        mirrored = right - 2.0 * distance[:, None] * normal
        residual = np.concatenate([(mirrored - points[self.left]).ravel(), middle @ normal + d])
        if not want_jacobian:
            return residual, None
        count, rows, columns = len(right), len(residual), self.left_derivative.shape[2]
        jacobian = np.empty((rows, columns + 3))
        pairs = jacobian[: 3 * count].reshape(count, 3, columns + 3)
        reflection = np.eye(3) - 2.0 * np.outer(normal, normal)
        pairs[:, :, :columns] = reflection @ self.right_derivative - self.left_derivative
        # d/dn [-2 (n'X + d) n] B = -2 [(n'X + d) B + n X'B]
        along = (right @ basis)[:, None, :] * normal[:, None]
        pairs[:, :, columns:-1] = -2.0 * (distance[:, None, None] * basis + along)
        pairs[:, :, -1] = -2.0 * normal
        jacobian[3 * count :, :columns] = normal @ self.middle_derivative
        jacobian[3 * count :, columns:-1] = middle @ basis
        jacobian[3 * count :, -1] = 1.0
        return residual, jacobian
