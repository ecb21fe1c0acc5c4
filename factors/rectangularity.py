"""Rectangular faces: "it is not enough if certain points are planar; they must also be rectangular" (section III-C).

For a quad a, b, c, d in order around the face,

    r = (a - b + c - d,  |a - c| - |b - d|)    in metres

The first three rows vanish for a parallelogram (which is planar), the fourth for one whose diagonals have equal length:
together, for a rectangle. Differences of lengths are taken rather than the angle between two edges, so that all rows
have one unit and a short edge is not weighed like a long one.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import gtsam
import numpy as np
from numpy.typing import ArrayLike, NDArray

from factors.checks import index_array
from factors.errors import InvalidInputError
from factors.guard import Evaluation, guarded_factor
from factors.noise import Noise
from factors.shape import LinearShape

__all__ = ["SHORTEST_DIAGONAL", "rectangularity_factor"]

SHORTEST_DIAGONAL = 1e-9
"""Metres; a diagonal of no more has no direction, and its derivative is taken as zero."""

# Rows: a - b + c - d, and the diagonals a - c and b - d.
_DIFFERENCES = np.array([[1.0, -1.0, 1.0, -1.0], [1.0, 0.0, -1.0, 0.0], [0.0, 1.0, 0.0, -1.0]])


def rectangularity_factor(shape: LinearShape, quad: ArrayLike, noise: Noise) -> gtsam.CustomFactor:
    """The four keypoints of a face form a rectangle: 4 rows, metres.

    Args:
        shape: The keypoints.
        quad: (4,) indices in order around the face.
        noise: Noise model of dimension 4, or sigma in metres.

    Raises:
        InvalidInputError: The quad does not have four distinct keypoints, or an index is out of range.
    """
    indices = index_array("quad", quad, shape.size, at_least=4)
    if len(indices) != 4:
        raise InvalidInputError("quad", indices.tolist(), "Give four keypoints in order around the face.")
    parallelogram, first, second = np.tensordot(_DIFFERENCES, shape.derivative[indices], axes=1)
    callback = _Rectangularity(shape, indices, parallelogram, first, second)
    return guarded_factor("rectangularity", noise, shape.keys, shape.dims, 4, callback)


@dataclass(frozen=True, slots=True)
class _Rectangularity:
    """Holds the derivatives (3, D) of the parallelogram and of the two diagonals, which are constant."""

    shape: LinearShape
    quad: NDArray[np.intp]
    parallelogram: NDArray[np.float64]
    first: NDArray[np.float64]
    second: NDArray[np.float64]

    def __call__(self, values: gtsam.Values, want_jacobian: bool) -> Evaluation:
        differences = _DIFFERENCES @ self.shape.points(values)[self.quad]
        first, second = differences[1], differences[2]
        length = max(math.sqrt(first @ first), SHORTEST_DIAGONAL)
        other = max(math.sqrt(second @ second), SHORTEST_DIAGONAL)
        residual = np.empty(4)
        residual[:3] = differences[0]
        residual[3] = length - other
        if not want_jacobian:
            return residual, None
        jacobian = np.empty((4, self.parallelogram.shape[1]))
        jacobian[:3] = self.parallelogram
        jacobian[3] = (first / length) @ self.first - (second / other) @ self.second
        return residual, jacobian
