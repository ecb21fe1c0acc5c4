"""A 2D box as evidence: the projected surface touches its four edges. Residual in pixels.

    r = (min_p u_p - x1,  min_p v_p - y1,  max_p u_p - x2,  max_p v_p - y2)

over points p of the vehicle's surface. Not in the paper, whose poses come from 3D boxes. With hard extremes the energy
has a crease wherever one point hands over to the next (a box seen square on lies on one), on which Levenberg-Marquardt
never settles. So the extremes are soft: max_p u_p becomes sum_p w_p u_p with w = softmax(u / softness), which is exact
for one point and for several in one place, and at most 0.28 softness too small between two. An edge that the image
border cuts off says nothing about the vehicle and is left out.

A car that is seen square on and is wider than its box still lies on a crease: whichever way it turns, another point is
the outermost one. Gauss and Newton's steps leap to and fro over it, since they know one side only. `crease_rows` tells
them of the other.
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
from factors.kernel import Projection, ProjectionKernel
from factors.noise import Noise
from factors.projection import by_pose, pixel_jacobian

__all__ = ["OUTWARD", "box_factor", "crease_rows", "extents_by_points", "kink", "projected_extents", "soft_extents"]

OUTWARD = np.array([-1.0, -1.0, 1.0, 1.0])
"""Which way each edge x1, y1, x2, y2 looks."""


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


def soft_extents(pixels: NDArray[np.float64], softness: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Soft extents of projected points, for any number of poses.

    Args:
        pixels: (..., P, 2) pixels.
        softness: Pixels over which one point hands over to the next.

    Returns:
        (..., 4) extents x1, y1, x2, y2, and (..., 4, P) their derivative by the pixels of their axis.
    """
    upright = np.swapaxes(pixels, -1, -2)
    outward = np.concatenate([-upright, upright], axis=-2)  # (..., 4, P): x1, y1, x2, y2
    # Beyond 40 softnesses a weight is below the rounding of the sum; numbers near the smallest float are slow.
    weight = np.exp(np.maximum((outward - outward.max(axis=-1, keepdims=True)) / softness, -40.0))
    weight /= weight.sum(axis=-1, keepdims=True)
    extent = (weight * outward).sum(axis=-1)
    share = weight * (1.0 + (outward - extent[..., None]) / softness)
    return extent * OUTWARD, share


def extents_by_points(
    camera_matrix: NDArray[np.float64],
    camera: NDArray[np.float64],
    rotation: NDArray[np.float64],
    points: NDArray[np.float64],
    share: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
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
) -> Evaluation:
    """Soft extents (4,) of a kernel's points, pixels, and where wanted their derivative (4, D) by its variables."""
    at = kernel.evaluate(values)
    extents, share = soft_extents(at.pixels, softness)
    return extents, _by_variables(kernel, at, share) if want_jacobian else None


def kink(behind: NDArray[np.float64], softness: float) -> NDArray[np.float64]:
    """Curvature of the parabola that touches the soft maximum of two pixels and lies nowhere below it.

    With d the difference of the pixels the maximum is their mean and (d / 2) tanh(d / (2 softness)), which is even, and
    whose slope over d, h'(d) / d, falls with |d|: so the parabola with this curvature lies above it.

    Args:
        behind: (...) how many pixels one is behind the other, not negative.
        softness: As in `soft_extents`.
    """
    away = np.maximum(behind / softness, 1e-3)
    e = np.exp(-away)
    curvature: NDArray[np.float64] = (0.5 * (1.0 - e) / (1.0 + e) + away * e / (1.0 + e) ** 2) / (away * softness)
    return curvature


def crease_rows(
    kernel: ProjectionKernel, values: gtsam.Values, softness: float, beyond: NDArray[np.float64]
) -> NDArray[np.float64]:
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


def _by_variables(kernel: ProjectionKernel, at: Projection, share: NDArray[np.float64]) -> NDArray[np.float64]:
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


@dataclass(frozen=True, slots=True)
class _Box:
    kernel: ProjectionKernel
    box: NDArray[np.float64]
    used: NDArray[np.intp]
    softness: float

    def __call__(self, values: gtsam.Values, want_jacobian: bool) -> Evaluation:
        extents, jacobian = projected_extents(self.kernel, values, self.softness, want_jacobian=want_jacobian)
        return extents[self.used] - self.box, None if jacobian is None else jacobian[self.used]
