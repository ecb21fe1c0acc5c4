"""Pose from weighted 2D-3D correspondences, globally optimal (ASPnP).

The rotation R from the object into the camera frame is represented by a quaternion q without unit norm, |q|^2 = 1 / z
with z the depth of the points' weighted centroid. Then R / z is quadratic in q and needs no constraint, and z no
unknown of its own. With X_i counted from the centroid, r1, r2, r3 the rows of R / z, and (t1, t2, 1) the centroid in
the camera frame divided by z, the cost is

    sum_i w_i [ (r1 X_i + t1 - u_i (1 + r3 X_i))^2 + (r2 X_i + t2 - v_i (1 + r3 X_i))^2 ],

the squared reprojection error times (z_i / z)^2, the squared relative depth of the point. For an object that is small
against its distance it is the reprojection error. It depends neither on the object frame nor on the unit of length.
The algebraic cost without the division by z (SQPnP's) shrinks with the distance, which draws noisy solutions towards
the camera. Solvers that fix one component of q at 1 and leave out the norm weight rotations by how they lie in the
object frame, and miss those where that component is zero.

t1 and t2 are linear and eliminated. What remains is an even quartic in q, all of whose minima
`fgrecon.solve.proposals._polynomial` finds at once: there is no start to choose and no rotation is excluded.

References:
    Zheng, Sugimoto, Okutomi: ASPnP: an accurate and scalable solution to the perspective-n-point problem, IEICE
    Transactions 2013. Zheng, Kuang, Sugimoto, Astrom, Okutomi: Revisiting the PnP problem: a fast, general and
    optimal solution, ICCV 2013 (OPnP, whose cost this is, with weights).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from factors.native import native
from fgrecon.core.arrays import Array
from fgrecon.core.checks import as_finite, as_shape
from fgrecon.core.errors import DegenerateProblemError, InvalidInputError
from fgrecon.solve.proposals import _polynomial

_EXPLAINED = 1e-9  # smallest relative gain over an object at infinity that is no rounding error
_THICKNESS = 1e-6  # spread across a line, relative to that along it, up to which points count as collinear


@dataclass(frozen=True, eq=False)
class PnPSolution:
    """A local minimum of the cost."""

    camera_T_object: Array  # (4, 4) rigid transform from the object into the camera frame, in the unit of the points
    cost: float  # the cost of the module's docstring, in squared normalised image units times the unit of the weights
    rms: float  # sqrt(cost / sum of the weights), normalised image units; times the focal length it is pixels
    weight_in_front: float  # share of the weight, above 0.5 and up to 1, whose points lie in front of the camera


def aspnp(
    points: ArrayLike,
    image_points: ArrayLike,
    weights: ArrayLike | None = None,
    *,
    tolerance: float = 0.05,
    every: bool = True,
) -> tuple[PnPSolution, ...]:
    """All poses that explain the correspondences about as well as the best one does, best first.

    A planar or a far object often has two such poses, which mirror each other in depth, and three points have up to
    four. A solution puts the weighted centroid and the points of more than half of the weight in front of the
    camera. Not all of them: one wrong correspondence must not forbid the pose that the others agree on.

    Args:
        points: (N, 3) points in the object frame.
        image_points: (N, 2) where they are observed, as normalised image coordinates (x / z, y / z).
        weights: (N,) non-negative weights of the squared errors, or None for ones. Rows of weight zero are ignored,
            whatever they hold.
        tolerance: How much larger a solution's rms may be than the best one's, relative to the weighted rms distance
            of the image points from their centroid; `inf` for all local minima.
        every: Whether to make sure that no minimum is missing; else Newton's method looks for them from 48 starts.

    Returns:
        At least one solution, by increasing cost.

    Raises:
        InvalidInputError: Wrong shapes, values that are not finite, a negative weight or tolerance.
        DegenerateProblemError: Fewer than three points of positive weight, collinear points, all image points in one
            place, or no minimum in front of the camera.
    """
    if not tolerance >= 0:
        raise InvalidInputError("tolerance", tolerance, "Give a number that is not negative.")
    points, image_points, weights = _checked(points, image_points, weights)
    total = float(weights.sum())
    w = weights / total
    centroid = w @ points
    X, scale = _scaled(points - centroid, w)
    kernel = None if every else native("fgrecon.solve._native")
    found = _minima(X, image_points, w, every=every) if kernel is None else _descended(kernel, X, image_points, w)

    weight_in_front = 1 - found.behind  # exactly 1 where no point is
    kept = np.flatnonzero((weight_in_front > 0.5) & (found.rms < (1 - _EXPLAINED) * found.spread))
    if not len(kept):
        fix = "No pose in front of the camera explains the image points: mend the correspondences."
        raise DegenerateProblemError("image_points", f"{len(points)} correspondences", fix)
    kept = kept[np.argsort(found.rms[kept])]
    solutions = []
    for i in kept[found.rms[kept] <= found.rms[kept[0]] + tolerance * found.spread]:
        pose, rms = np.eye(4), float(found.rms[i])
        pose[:3, :3] = found.r[i].reshape(3, 3) / found.squared_length[i]
        ray = np.append((w * (1 + X @ found.r[i, 6:])) @ image_points, 1.0)
        pose[:3, 3] = ray * (scale / found.squared_length[i]) - pose[:3, :3] @ centroid
        solutions.append(PnPSolution(pose, total * rms**2, rms, float(weight_in_front[i])))
    return tuple(solutions)


class _Found(NamedTuple):
    """Minima of the cost."""

    r: Array  # (B, 9) R / z, row by row
    squared_length: Array  # (B,) of q
    rms: Array  # (B,)
    behind: Array  # (B,) share of the weight that is behind the camera
    spread: float  # the rms of an object at infinity


def _minima(X: Array, image_points: Array, w: Array, *, every: bool) -> _Found:
    A, b = _residuals(X, image_points, w)
    linear = (-2 * b @ A)[None].dot(_FORMS.reshape(9, 16)).reshape(4, 4)
    q = _polynomial.minima(_ROWS.T @ (A.T @ A) @ _ROWS, linear, every=every).q
    r = _polynomial.products(q) @ _ROWS.T
    behind = (1 + r[:, 6:] @ X.T <= 0) @ w
    return _Found(r, (q * q).sum(axis=1), np.linalg.norm(r @ A.T - b, axis=1), behind, float(np.linalg.norm(b)))


def _descended(kernel: Any, X: Array, image_points: Array, w: Array) -> _Found:
    """The same, compiled, of those that are found by descending."""
    arrays = map(np.ascontiguousarray, (X, image_points, w, _ROWS))
    r, summary, spread, widest = kernel.pnp(*arrays, *_polynomial.descent())
    _check_apart(widest, image_points)
    squared_length, rms, behind = summary.T
    return _Found(r, squared_length, rms, behind, spread)


def _checked(points: ArrayLike, image_points: ArrayLike, weights: ArrayLike | None) -> tuple[Array, Array, Array]:
    """Arrays with at least three rows of positive weight; rows of weight zero are dropped."""
    points = as_shape("points", points, (None, 3))
    image_points = as_shape("image_points", image_points, (len(points), 2))
    weights = np.ones(len(points)) if weights is None else as_finite("weights", weights, (len(points),))
    if (weights < 0).any():
        raise InvalidInputError("weights", float(weights.min()), "Give weights that are not negative.")
    used = weights > 0
    count = np.count_nonzero(used)
    if count < 3:
        usable = f"{count} of {len(points)} above zero"
        raise DegenerateProblemError("weights", usable, "Give at least three points a positive weight.")
    if count < len(points):  # whatever the others hold
        points, image_points = np.where(used[:, None], points, 0.0), np.where(used[:, None], image_points, 0.0)
    as_finite("points", points, (None, 3))
    as_finite("image_points", image_points, (None, 2))
    return points[used], image_points[used], weights[used]


def _scaled(X: Array, w: Array) -> tuple[Array, float]:
    """Centred points (N, 3) divided by their rms distance from the centroid, and that distance."""
    moments = (w[:, None] * X).T @ X
    trace = float(moments.trace())  # of the squares of the spreads along three axes, whose products in pairs are:
    pairs = (trace**2 - float(np.vdot(moments, moments))) / 2
    if not pairs > _THICKNESS**2 * trace**2:
        fix = "Give points of positive weight that are not on one line."
        raise DegenerateProblemError("points", f"{len(X)} points on a line", fix)
    scale = math.sqrt(trace)
    return X / scale, scale


def _residuals(X: Array, image_points: Array, w: Array) -> tuple[Array, Array]:
    """A (2N, 9) and b (2N,) with |A r - b|^2 = the cost; r is R / z row by row, t eliminated, w of sum one."""
    n, root = len(X), np.sqrt(w)
    uX = image_points.T[:, :, None] * X
    A = np.zeros((2, n, 9))
    A[0, :, :3] = A[1, :, 3:6] = X
    A[:, :, 6:] = (w @ uX)[:, None] - uX
    b = image_points.T - (w @ image_points)[:, None]
    _check_apart(np.abs(b).max(), image_points)
    return (A * root[:, None]).reshape(2 * n, 9), (b * root).ravel()


def _check_apart(widest: float, image_points: Array) -> None:
    """Refuse image points whose largest deviation from their mean is none."""
    if not widest > 1e-12 * max(1.0, np.abs(image_points).max()):
        raise DegenerateProblemError("image_points", "all in one place", "Give image points of the visible object.")


def _rotation_forms() -> tuple[Array, Array]:
    """The nine entries of |q|^2 R as forms q' F q (9, 4, 4) and as rows (9, 10) that multiply m(q)."""
    a, b, c, d = np.eye(4)

    def form(x: Array, y: Array) -> Array:
        return np.outer(x, y) + np.outer(y, x)

    aa, bb, cc, dd = (form(x, x) / 2 for x in (a, b, c, d))
    forms = np.array(
        [
            [aa + bb - cc - dd, form(b, c) - form(a, d), form(b, d) + form(a, c)],
            [form(b, c) + form(a, d), aa - bb + cc - dd, form(c, d) - form(a, b)],
            [form(b, d) - form(a, c), form(c, d) + form(a, b), aa - bb - cc + dd],
        ]
    ).reshape(9, 4, 4)
    i, j = _polynomial.PAIRS.T
    return forms, forms[:, i, j] * np.where(i == j, 1.0, 2.0)


_FORMS, _ROWS = _rotation_forms()
