"""A 2D box as evidence: the projected surface touches its four edges. Residual in pixels.

    r = (min_p u_p - x1,  min_p v_p - y1,  max_p u_p - x2,  max_p v_p - y2)

over points p of the vehicle's surface. Not in the paper, whose poses come from 3D boxes. The extremes are hard: the
Jacobian is that of the point which touches at the linearisation point. An edge that the image border cuts off says
nothing about the vehicle and is left out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import gtsam
import numpy as np
from numpy.typing import ArrayLike, NDArray

from factors.checks import finite_array
from factors.errors import InvalidInputError
from factors.guard import Evaluation, guarded_factor
from factors.kernel import ProjectionKernel
from factors.noise import Noise

__all__ = ["box_factor"]


def box_factor(
    kernel: ProjectionKernel,
    box: ArrayLike,
    noise: Noise,
    *,
    edges: Sequence[bool] = (True, True, True, True),
) -> gtsam.CustomFactor:
    """The projected extent of the surface equals the box: one row per used edge, pixels.

    Args:
        kernel: Projects points that cover the surface (up to about 150); its shape is driven by the same lambda key as
            the keypoints', but is one of its own: a `LinearShape` of the surface's mean and basis.
        box: (4,) edges x1, y1, x2, y2.
        noise: Noise model of as many rows as edges are used, or one sigma in pixels.
        edges: Which of the four are used; False where the image border cuts the vehicle off.

    Raises:
        InvalidInputError: The box has no size, or no edge is used.
    """
    corners = finite_array("box", box, (4,))
    if not (corners[2:] > corners[:2]).all():
        raise InvalidInputError("box", corners.tolist(), "Give x1 < x2 and y1 < y2.")
    if len(edges) != 4 or not any(edges):
        raise InvalidInputError("edges", list(edges), "Use at least one of the four edges.")
    used = np.flatnonzero(np.asarray(edges, dtype=bool))
    callback = _Box(kernel, corners[used], used)
    return guarded_factor("box", noise, kernel.keys, kernel.dims, len(used), callback)


@dataclass(frozen=True, slots=True)
class _Box:
    kernel: ProjectionKernel
    box: NDArray[np.float64]
    used: NDArray[np.intp]

    def __call__(self, values: gtsam.Values, want_jacobian: bool) -> Evaluation:
        projection = self.kernel.evaluate(values, want_jacobian)
        pixels = projection.pixels
        touching = np.concatenate([pixels.argmin(axis=0), pixels.argmax(axis=0)])[self.used]
        axes = self.used % 2
        residual = pixels[touching, axes] - self.box
        if not want_jacobian or projection.jacobian is None:
            return residual, None
        return residual, projection.jacobian[touching, axes]
