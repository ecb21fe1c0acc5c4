"""A 2D box as evidence: the projected surface touches its four edges. Residual in pixels.

    r = (min_p u_p - x1,  min_p v_p - y1,  max_p u_p - x2,  max_p v_p - y2)

over points p of the vehicle's surface. Not in the paper, whose poses come from 3D boxes. With hard extremes the energy
has a crease wherever one point hands over to the next (a box seen square on lies on one), on which Levenberg-Marquardt
never settles. So the extremes are soft: max_p u_p becomes sum_p w_p u_p with w = softmax(u / softness), which is exact
for one point and for several in one place, and at most 0.28 softness too small between two. Of the many points of a
surface it is 0.7 softness too small in the mean, which would bring cars nearer: edges are moved inwards by as much
(`BoxRows.inside`). An edge that the image border cuts off says nothing about the vehicle and is left out.

A car that is seen square on and is wider than its box still lies on a crease: whichever way it turns, another point is
the outermost one. Gauss and Newton's steps leap to and fro over it, since they know one side only. `crease_rows` tells
them of the other.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from factors.arrays import Array
from factors.mixture import mixture
from factors.projection import by_pose, pixel_jacobian

if TYPE_CHECKING:  # on use: most of this needs numpy alone
    import gtsam

    from factors.projection_kernel import Projection, ProjectionKernel


OUTWARD = np.array([-1.0, -1.0, 1.0, 1.0])
"""Which way each edge x1, y1, x2, y2 looks."""

FARTHEST_SHARE = 40.0
"""Softnesses behind the outermost point beyond which one has no share in an extent: it is below the sum's rounding."""

NEAREST_KINK = 1e-3
"""Softnesses: two points that are nearer to one another have the curvature of this distance."""


@dataclass(frozen=True)
class BoxRows:
    """A 2D box and how well its edges are known.

    Attributes:
        edges: (4,) x1, y1, x2, y2, pixels.
        used: (4,) which edges count: not one where the image border cuts the vehicle off.
        sigma: Standard deviation of an edge, pixels.
        wrong: Density of a wrong edge relative to a right one's peak, times the odds of being wrong.
        softness: Pixels over which one outermost point hands over to the next; a fraction of sigma is right.
        inside: (4,) pixels by which soft extents of such points lie inside the hard ones, in the mean.
    """

    edges: Array
    used: NDArray[np.bool_]
    sigma: float
    wrong: float
    softness: float
    inside: Array = field(default_factory=lambda: np.zeros(4))

    @cached_property
    def soft_edges(self) -> Array:
        """(4,) where soft extents are to be, pixels."""
        return self.edges - OUTWARD * self.inside

    def residual(self, extents: Array) -> Array:
        """Whitened residuals (..., 4) of soft extents (..., 4)."""
        return (extents - self.soft_edges) / self.sigma

    def assess(self, residual: Array) -> tuple[Array, Array, Array]:
        """Weights (..., 4) and losses (..., 4) of whitened residuals, and the edges' energy (...) in nats."""
        right = np.where(self.used, 1.0, 0.0)
        weights, losses = mixture(right, np.full(4, self.wrong), np.square(residual))
        energy: Array = (losses - right * np.log(1.0 + self.wrong)).sum(axis=-1)
        return weights, losses, energy


def soft_extents(pixels: Array, softness: float | Array) -> tuple[Array, Array]:
    """Soft extents of projected points, for any number of poses.

    Args:
        pixels: (..., P, 2) pixels.
        softness: Pixels over which one point hands over to the next; (..., 1, 1) of each pose, or of all.

    Returns:
        (..., 4) extents x1, y1, x2, y2, and (..., 4, P) their derivative by the pixels of their axis.
    """
    upright = np.swapaxes(pixels, -1, -2)
    outward = np.concatenate([-upright, upright], axis=-2)  # (..., 4, P): x1, y1, x2, y2
    # Numbers near the smallest float are slow.
    weight = np.exp(np.maximum((outward - outward.max(axis=-1, keepdims=True)) / softness, -FARTHEST_SHARE))
    weight /= weight.sum(axis=-1, keepdims=True)
    extent = (weight * outward).sum(axis=-1)
    share = weight * (1.0 + (outward - extent[..., None]) / softness)
    return extent * OUTWARD, share


def extents_by_points(
    camera_matrix: Array,
    camera: Array,
    rotation: Array,
    points: Array,
    share: Array,
) -> tuple[Array, Array, Array]:
    """Derivatives of the extents by pose and points.

    Points come last in memory, and sums over them are one product: with g_p the derivative of an edge by the object
    point X_p, sum_p g_p (X_p, 1)' holds that by the translation, and in its antisymmetric part X_p x g_p, that by the
    turn.

    Args:
        camera_matrix: (3, 3) intrinsics.
        camera: (..., P, 3) points in the camera frame.
        rotation: (..., 3, 3) of camera_T_object.
        points: (..., P, 3) points in the object frame.
        share: (..., 4, P) derivative of the edges by the pixels of their axis.

    Returns:
        (..., 4, 3) by a turn about the object's axes; (..., 4, 3) by a shift along them; (..., 4, 3, P) by each point.
    """
    leading, size = camera.shape[:-2], camera.shape[-2]
    gradient = np.ascontiguousarray(np.moveaxis(pixel_jacobian(camera_matrix, camera), -3, -1))  # (..., 2, 3, P)
    gradient = np.swapaxes(rotation, -1, -2)[..., None, :, :] @ gradient
    by_point = (share.reshape(*leading, 2, 2, 1, size) * gradient[..., None, :, :, :]).reshape(*leading, 4, 3, size)
    homogeneous = np.ones((*leading, 1, size, 4))
    homogeneous[..., 0, :, :3] = points
    moment = by_point @ homogeneous
    turn = np.empty((*leading, 4, 3))
    turn[..., 0] = moment[..., 2, 1] - moment[..., 1, 2]
    turn[..., 1] = moment[..., 0, 2] - moment[..., 2, 0]
    turn[..., 2] = moment[..., 1, 0] - moment[..., 0, 1]
    return turn, moment[..., 3], by_point


def projected_extents(
    kernel: ProjectionKernel, values: gtsam.Values, softness: float, *, want_jacobian: bool = False
) -> tuple[Array, Array | None]:
    """Soft extents (4,) of a kernel's points, pixels, and where wanted their derivative (4, D) by its variables."""
    at = kernel.evaluate(values)
    extents, share = soft_extents(at.pixels, softness)
    return extents, _by_variables(kernel, at, share) if want_jacobian else None


def kink(behind: Array, softness: float) -> Array:
    """Curvature of the parabola that touches the soft maximum of two pixels and lies nowhere below it.

    With d the difference of the pixels the maximum is their mean and (d / 2) tanh(d / (2 softness)), which is even, and
    whose slope over d, h'(d) / d, falls with |d|: so the parabola with this curvature lies above it.

    Args:
        behind: (...) how many pixels one is behind the other, not negative.
        softness: As in `soft_extents`.
    """
    away = np.maximum(behind / softness, NEAREST_KINK)
    e = np.exp(-away)
    return (0.5 * (1.0 - e) / (1.0 + e) + away * e / (1.0 + e) ** 2) / (away * softness)


def crease_rows(kernel: ProjectionKernel, values: gtsam.Values, softness: float, beyond: Array) -> Array:
    """Rows (4, D) that add to J'J what a crease of the outline bends the energy by, at the most.

    An edge's energy with slope f by its extent, outwards, bends by f times the extent's second derivative. Of the
    outermost point and another one that is `kink` times the square of their derivatives' difference, at the most; the
    other one is that for which this is greatest by a turn of the vehicle. Where the outline is inside its box the
    energy bends the other way and there is no row.

    Args:
        kernel: Projects the points.
        values: Where.
        softness: As in `soft_extents`.
        beyond: (4,) slope of each edge's energy by its extent, outwards, per pixel; not positive where it is inside.
    """
    at = kernel.evaluate(values)
    upright = at.pixels.T
    turns, _ = by_pose(at.points, at.rotation, pixel_jacobian(at.matrix, at.camera))  # (P, 2, 3)
    share = np.zeros((4, len(at.points)))
    for edge in np.flatnonzero(beyond > 0.0):
        outward = OUTWARD[edge] * upright[edge % 2]
        first = int(outward.argmax())
        stiff = kink(outward[first] - outward, softness)
        away = turns[:, edge % 2] - turns[first, edge % 2]
        second = int((stiff * np.square(away).sum(axis=1)).argmax())
        root = np.sqrt(beyond[edge] * stiff[second])
        share[edge, first] += root
        share[edge, second] -= root
    return _by_variables(kernel, at, share)


def _by_variables(kernel: ProjectionKernel, at: Projection, share: Array) -> Array:
    """(4, D) derivative by a kernel's variables of sums of pixels with shares (4, P): two of u, two of v."""
    shape = kernel.shape
    turn, shift, by_point = extents_by_points(at.matrix, at.camera, at.rotation, at.points, share)
    blocks = [] if kernel.pose_key is None else [turn, shift]
    if shape.keys:
        blocks.append(shape.chain(by_point.transpose(0, 2, 1).reshape(4, -1)))
    if kernel.focal_key is not None:
        away = (at.pixels - at.matrix[:2, 2]).T
        blocks.append((share * np.concatenate([away, away])).sum(axis=1, keepdims=True))
    return np.concatenate(blocks, axis=1) if blocks else np.zeros((4, 0))
