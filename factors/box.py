"""A 2D box as evidence: the projected surface touches its four edges. Residual in pixels.

    r = (min_p u_p - x1,  min_p v_p - y1,  max_p u_p - x2,  max_p v_p - y2)

over points p of the vehicle's surface. Not in the paper, whose poses come from 3D boxes. With hard extremes the energy
has a crease wherever one point hands over to the next (a box seen square on lies on one), on which Levenberg-Marquardt
never settles. So the extremes are soft: max_p u_p becomes sum_p w_p u_p with w = softmax(u / softness), which is exact
for one point and for several in one place, and at most 0.28 softness too small between two. An edge that the image
border cuts off says nothing about the vehicle and is left out.
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
    softness: float,
    edges: Sequence[bool] = (True, True, True, True),
) -> gtsam.CustomFactor:
    """The projected extent of the surface equals the box: one row per used edge, pixels.

    Args:
        kernel: Projects points that cover the surface (up to about 150); its shape is driven by the same lambda key as
            the keypoints', but is one of its own: a `LinearShape` of the surface's mean and basis.
        box: (4,) edges x1, y1, x2, y2.
        noise: Noise model of as many rows as edges are used, or one sigma in pixels.
        softness: Pixels over which one point hands over to the next; a fraction of the noise's sigma is right.
        edges: Which of the four are used; False where the image border cuts the vehicle off.

    Raises:
        InvalidInputError: The box has no size, no edge is used, or the softness is not positive.
    """
    corners = finite_array("box", box, (4,))
    if not (corners[2:] > corners[:2]).all():
        raise InvalidInputError("box", corners.tolist(), "Give x1 < x2 and y1 < y2.")
    if len(edges) != 4 or not any(edges):
        raise InvalidInputError("edges", list(edges), "Use at least one of the four edges.")
    if not (np.isfinite(softness) and softness > 0):
        raise InvalidInputError("softness", softness, "Give a positive number of pixels.")
    used = np.flatnonzero(np.asarray(edges, dtype=bool))
    callback = _Box(kernel, corners[used], used, float(softness))
    return guarded_factor("box", noise, kernel.keys, kernel.dims, len(used), callback)


@dataclass(frozen=True, slots=True)
class _Box:
    kernel: ProjectionKernel
    box: NDArray[np.float64]
    used: NDArray[np.intp]
    softness: float

    def __call__(self, values: gtsam.Values, want_jacobian: bool) -> Evaluation:
        projection = self.kernel.evaluate(values, want_jacobian)
        upright = projection.pixels.T
        outward = np.concatenate([-upright, upright])[self.used]  # (E, P)
        weight = np.exp((outward - outward.max(axis=1, keepdims=True)) / self.softness)
        weight /= weight.sum(axis=1, keepdims=True)
        extent = (weight * outward).sum(axis=1)
        residual = np.where(self.used < 2, -extent, extent) - self.box
        if not want_jacobian or projection.jacobian is None:
            return residual, None
        share = weight * (1.0 + (outward - extent[:, None]) / self.softness)
        by_axis = projection.jacobian.transpose(1, 0, 2)[self.used % 2]  # (E, P, D)
        return residual, (share[:, None] @ by_axis)[:, 0]
