"""Length, width and height close to their prior: E_dim of the paper's section III-C, in metres.

    r = D X(lambda, offsets) - (l, w, h)

D is linear (differences of keypoint groups divided by their ratio to the vehicle's box). mu_l, mu_w and mu_h of the
paper are 1 / sigma^2 of the noise model.
"""

from __future__ import annotations

import gtsam
import numpy as np
from numpy.typing import ArrayLike

from factors.arrays import Array
from factors.checks import finite_array
from factors.noise import diagonal_noise
from factors.shape import LinearShape
from factors.shape_factor import ShapeContext, ShapeTerm, shape_factor


class DimensionsTerm(ShapeTerm):
    """Where the size of the fleet is known."""

    name = "dimensions"

    def applies(self, about: ShapeContext) -> bool:
        """Whether a size is known."""
        return about.size is not None

    def factors(self, about: ShapeContext) -> list[gtsam.NonlinearFactor]:
        """One factor."""
        assert about.size is not None
        return [dimensions_factor(about.shape, about.dimension_operator, *about.size)]


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
    linear, mean = finite_array("operator", operator, (3, shape.size, 3)), finite_array("size", size, (3,))

    def rows(points: Array, _plane: Array, want: bool) -> tuple[Array, Array | None, None]:
        return np.tensordot(linear, points, axes=2) - mean, linear if want else None, None

    noise = diagonal_noise("sigmas", finite_array("sigmas", sigmas, (3,)))
    return shape_factor("dimensions", noise, shape, 3, rows)
