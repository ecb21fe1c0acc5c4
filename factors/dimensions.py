"""Length, width and height close to their prior: E_dim of the paper's section III-C, in metres.

    r = D X(lambda, offsets) - (l, w, h)

D is linear (differences of keypoint groups divided by their ratio to the vehicle's box), so that the Jacobian is a
constant. mu_l, mu_w and mu_h of the paper are 1 / sigma^2 of the noise model.
"""

from __future__ import annotations

from dataclasses import dataclass

import gtsam
import numpy as np
from numpy.typing import ArrayLike, NDArray

from factors.checks import finite_array
from factors.guard import Evaluation, guarded_factor
from factors.noise import diagonal_noise
from factors.shape import LinearShape

__all__ = ["dimensions_factor"]


def dimensions_factor(
    shape: LinearShape, operator: ArrayLike, size: ArrayLike, sigmas: ArrayLike
) -> gtsam.CustomFactor:
    """Prior on the vehicle's length, width and height: 3 rows, metres.

    Args:
        shape: The keypoints.
        operator: (3, K, 3) linear map from keypoints to length, width and height.
        size: (3,) prior mean, metres.
        sigmas: (3,) prior standard deviations, metres.

    Raises:
        InvalidInputError: An array has the wrong shape or is not finite, or the shape is a constant.
    """
    matrix = finite_array("operator", operator, (3, shape.size, 3)).reshape(3, -1)
    callback = _Dimensions(shape, matrix, finite_array("size", size, (3,)), shape.chain(matrix))
    noise = diagonal_noise("sigmas", finite_array("sigmas", sigmas, (3,)))
    return guarded_factor("dimensions", noise, shape.keys, shape.dims, 3, callback)


@dataclass(frozen=True, slots=True)
class _Dimensions:
    shape: LinearShape
    operator: NDArray[np.float64]
    size: NDArray[np.float64]
    jacobian: NDArray[np.float64]

    def __call__(self, values: gtsam.Values, want_jacobian: bool) -> Evaluation:
        residual = self.operator @ self.shape.points(values).ravel() - self.size
        return residual, self.jacobian if want_jacobian else None
