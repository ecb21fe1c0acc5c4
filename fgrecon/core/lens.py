"""Fisheye lenses: from the plane of a lens's own image to directions ahead of the camera, and back.

| model | coefficients | as in |
|---|---|---|
| `fisheye` | k1 to k4 of the angle a: r = a (1 + k1 a^2 + k2 a^4 + ...) | `cv2.fisheye`, equidistant, Kannala-Brandt |
| `mei` | xi, then k1, k2, p1, p2 of the plane behind the unit sphere | omni (Kalibr), MEI (camodocal), `cv2.omnidir` |

Points are (M, 2) at z = 1; what comes from more than `WIDEST_DEGREES` to the side has none, and is NaN. (OpenCV's own
functions give such a pixel the mirrored direction, or the edge's.)
"""

from __future__ import annotations

from typing import Any

import numpy as np

from fgrecon.core.arrays import Array

OPENCV, FISHEYE, MEI = "opencv", "fisheye", "mei"
COUNTS = {OPENCV: (4, 5, 8, 12, 14), FISHEYE: (4,), MEI: (5,)}
"""How many coefficients each model has."""

WIDEST_DEGREES = 85.0
"""Where a pixel of error is 130 of a pinhole's; a pinhole has no place for 90."""

_WIDEST = np.radians(WIDEST_DEGREES)
_STEPS, _NEWTON = 2000, 3  # of the table of angles, and from it on: then it is exact


def ahead(model: str, coefficients: Array, points: Array) -> Array:
    """(M, 2) at z = 1 of points (M, 2) of the lens's image, in focal lengths from its centre."""
    return _fisheye_ahead(coefficients, points) if model == FISHEYE else _mei_ahead(coefficients, points)


def imaged(model: str, coefficients: Array, points: Array) -> Array:
    """The reverse of `ahead`."""
    distance = np.linalg.norm(points, axis=1)
    if model == FISHEYE:
        angle = np.arctan(distance)
        radius = _radius(coefficients, angle)
        return points * _ratio(radius, distance)
    import cv2  # on use: importing fgrecon must not import OpenCV

    flat = points / (1.0 + coefficients[0] * np.hypot(1.0, distance))[:, None]
    still, places = np.zeros(3), np.column_stack([flat, np.ones(len(flat))])
    bent: Any = cv2.projectPoints(places, still, still, np.eye(3), coefficients[1:])
    return np.asarray(bent[0][:, 0], dtype=np.float64)


def _ratio(radius: Array, other: Array) -> Array:
    """(M, 1) how many times as far from the centre; 1 at the centre."""
    return np.divide(radius, other, out=np.ones_like(other), where=other > 0.0)[:, None]


def _radius(lens: Array, angle: Array) -> Array:
    square = angle**2
    return angle * (1.0 + square * (lens[0] + square * (lens[1] + square * (lens[2] + square * lens[3]))))


def _fisheye_ahead(lens: Array, points: Array) -> Array:
    grid = np.linspace(0.0, _WIDEST, _STEPS)
    radii = _radius(lens, grid)
    turns = np.flatnonzero(np.diff(radii) <= 0.0)  # no ray arrives farther out
    last = int(turns[0]) if len(turns) else _STEPS - 1
    radius = np.linalg.norm(points, axis=1)
    angle = np.interp(radius, radii[: last + 1], grid[: last + 1], right=np.nan)
    for _ in range(_NEWTON):
        square = angle**2
        slope = 1.0 + square * (3 * lens[0] + square * (5 * lens[1] + square * (7 * lens[2] + square * 9 * lens[3])))
        angle -= (_radius(lens, angle) - radius) / slope
    return points * _ratio(np.tan(angle), radius)


def _mei_ahead(lens: Array, points: Array) -> Array:
    import cv2

    xi = lens[0]
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-14)
    flat: Any = cv2.undistortPoints(points[:, None], np.eye(3), lens[1:], criteria=criteria)
    flat = np.asarray(flat[:, 0], dtype=np.float64)
    square = (flat**2).sum(axis=1)
    with np.errstate(invalid="ignore"):
        along = (xi + np.sqrt(1.0 + (1.0 - xi**2) * square)) / (1.0 + square)  # from the sphere's centre
        depth = along - xi
        inside = depth > np.cos(_WIDEST)
    return np.where(inside, along / np.where(inside, depth, 1.0), np.nan)[:, None] * flat
