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
from factors.planes import tangent_basis
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
    difference = shape.derivative[right] - shape.derivative[left]
    along = np.concatenate([right, middle])
    axes_first = np.ascontiguousarray(shape.derivative[along].transpose(1, 0, 2)).reshape(3, -1)
    callback = _Symmetry(shape, left, along, difference, axes_first, plane_key)
    rows = 3 * len(left) + len(middle)
    return guarded_factor("symmetry", noise, (*shape.keys, plane_key), (*shape.dims, 3), rows, callback)


@dataclass(frozen=True, slots=True)
class _Symmetry:
    """P pairs and Q keypoints in the middle.

    Attributes:
        shape: The keypoints.
        left: (P,) indices of the left keypoints.
        along: (P + Q,) indices of the right keypoints, then those in the middle: all whose n'X + d is needed.
        difference: (P, 3, D) derivative of X_r - X_l.
        derivative: (3, (P + Q) D) derivative of the keypoints of `along`, axes first, so that one product with the
            normal covers them all.
        plane_key: Key of the medial plane.
    """

    shape: LinearShape
    left: NDArray[np.intp]
    along: NDArray[np.intp]
    difference: NDArray[np.float64]
    derivative: NDArray[np.float64]
    plane_key: int

    def __call__(self, values: gtsam.Values, want_jacobian: bool) -> Evaluation:
        points = self.shape.points(values)
        plane = values.atOrientedPlane3(self.plane_key)
        coefficients = plane.planeCoefficients()
        normal, count = coefficients[:3], len(self.left)
        along = points[self.along]
        distances = along @ normal + coefficients[3]
        residual = np.empty(2 * count + len(along))
        mirrored = along[:count] - (2.0 * distances[:count, None]) * normal
        residual[: 3 * count] = (mirrored - points[self.left]).ravel()
        residual[3 * count :] = distances[count:]
        if not want_jacobian:
            return residual, None
        columns = self.difference.shape[2]
        jacobian = np.empty((len(residual), columns + 3))
        pairs, middle = jacobian[: 3 * count].reshape(count, 3, columns + 3), jacobian[3 * count :]
        # (I - 2 n n') dX_r - dX_l, and with s = n'X_r + d: d/dn [-2 s n] B = -2 [s B + n (X_r'B)], d/dd = -2 n.
        moved = (normal @ self.derivative).reshape(len(along), columns)
        tangent = tangent_basis(plane)
        slides = along @ tangent
        twice = (-2.0 * normal)[:, None]
        pairs[:, :, :columns] = self.difference + twice * moved[:count, None]
        pairs[:, :, columns:-1] = twice * slides[:count, None] - (2.0 * distances[:count, None, None]) * tangent
        pairs[:, :, -1] = twice[:, 0]
        middle[:, :columns] = moved[count:]
        middle[:, columns:-1] = slides[count:]
        middle[:, -1] = 1.0
        return residual, jacobian
