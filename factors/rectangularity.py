"""Rectangular faces: "it is not enough if certain points are planar; they must also be rectangular" (section III-C).

For a quad a, b, c, d in order around the face,

    r = (a - b + c - d,  |a - c| - |b - d|)    in metres

The first three rows vanish for a parallelogram (which is planar), the fourth for one whose diagonals have equal length:
together, for a rectangle. Differences of lengths are taken rather than the angle between two edges, so that all rows
have one unit and a short edge is not weighed like a long one.
"""

from __future__ import annotations

import math

import gtsam
import numpy as np
from numpy.typing import ArrayLike

from factors.arrays import Array
from factors.checks import index_array
from factors.errors import InvalidInputError
from factors.noise import Noise
from factors.shape import LinearShape
from factors.shape_factor import ShapeContext, ShapeTerm, shape_factor

SHORTEST_DIAGONAL = 1e-9
"""Metres; a diagonal of no more has no direction, and its derivative is taken as zero."""

VANISHING = 1e-9
"""Metres: a residual that never exceeds this is none."""

_SIGNS = np.array([1.0, -1.0, 1.0, -1.0])


class RectangularityTerm(ShapeTerm):
    """One factor for each rectangular face."""

    name = "rectangularity"

    def applies(self, about: ShapeContext) -> bool:
        """Whether a face is a rectangle, and not for every shape anyway."""
        return bool(rectangles(about))

    def factors(self, about: ShapeContext) -> list[gtsam.NonlinearFactor]:
        """One for each face."""
        sigma = about.settings.rectangularity_sigma
        return [rectangularity_factor(about.shape, face, sigma) for face in rectangles(about)]


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

    def rows(points: Array, _plane: Array, want: bool) -> tuple[Array, Array | None, None]:
        a, b, c, d = points[indices]
        first, second = a - c, b - d
        length = max(math.sqrt(first @ first), SHORTEST_DIAGONAL)
        other = max(math.sqrt(second @ second), SHORTEST_DIAGONAL)
        residual = np.append(a - b + c - d, length - other)
        if not want:
            return residual, None, None
        by_points = np.zeros((4, len(points), 3))
        by_points[np.arange(3), indices[:, None], np.arange(3)] = _SIGNS[:, None]
        by_points[3, indices] = first / length, -second / other, -first / length, second / other
        return residual, by_points, None

    return shape_factor("rectangularity", noise, shape, 4, rows)


def rectangles(about: ShapeContext) -> list[tuple[int, ...]]:
    """Faces that are rectangles, but not for every value of the shape's variables anyway."""
    faces = [face.keypoints for face in about.faces if face.rectangular]
    return [face for face in faces if not _is_always_rectangular(about.shape, face)]


def _is_always_rectangular(shape: LinearShape, face: tuple[int, ...]) -> bool:
    """Whether a face is a rectangle for every lambda, as wheels that the prior has in one."""
    if shape.coefficients_key is None or shape.offsets_key is not None:
        return False
    factor = rectangularity_factor(shape, face, 1.0)
    for coefficients in np.vstack([np.zeros(shape.dims[0]), 3.0 * np.eye(shape.dims[0])]):
        values = gtsam.Values()
        values.insert(shape.coefficients_key, coefficients)
        if np.abs(factor.unwhitenedError(values)).max() > VANISHING:
            return False
    return True
