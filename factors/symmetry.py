"""Mirror symmetry about the medial plane: E_sym of the paper's section III-C, in metres.

    r = X_r - 2 (n'X_r + d) n - X_l    for each pair (left, right)
    r = n'X + d                        for each keypoint on the medial plane

The paper prints + 2 (d - n'X_r) n, which is the same for a plane n'X = d; here planes are n'X + d = 0 everywhere. With
a prior that is exactly symmetric and without free offsets the term vanishes for every lambda.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import gtsam
import numpy as np
from numpy.typing import ArrayLike, NDArray

from factors.arrays import Array
from factors.checks import index_array
from factors.errors import InvalidInputError
from factors.keys import M
from factors.noise import Noise
from factors.shape import LinearShape
from factors.shape_factor import ShapeContext, ShapeTerm, shape_factor


class SymmetryTerm(ShapeTerm):
    """One factor on the medial plane."""

    name = "symmetry"

    def applies(self, about: ShapeContext) -> bool:
        """Whether there are pairs, and the shape may be without symmetry."""
        return bool(about.pairs) and not about.always_symmetric

    def planes(self, about: ShapeContext) -> Mapping[int, NDArray[np.intp] | None]:
        """The medial plane."""
        return {M(about.number): None}

    def factors(self, about: ShapeContext) -> list[gtsam.NonlinearFactor]:
        """One factor."""
        key, sigma = M(about.number), about.settings.symmetry_sigma
        return [symmetry_factor(about.shape, about.pairs, key, sigma, on_plane=about.middle)]


def symmetry_factor(
    shape: LinearShape,
    pairs: Sequence[tuple[int, int]],
    plane_key: int,
    noise: Noise,
    *,
    on_plane: ArrayLike = (),
) -> gtsam.CustomFactor:
    """Pairs of keypoints mirror each other: 3 rows per pair, then one per keypoint on the plane, metres.

    Args:
        shape: The keypoints.
        pairs: Pairs (left, right) of mirror images.
        plane_key: Key of the medial plane, an `OrientedPlane3`.
        noise: Noise model of that many rows, or sigma in metres.
        on_plane: Keypoints that are their own mirror image.

    Raises:
        InvalidInputError: There are no pairs, or an index is out of range or repeated.
    """
    array = np.asarray(pairs)
    if array.ndim != 2 or array.shape[1] != 2:
        raise InvalidInputError("pairs", pairs, "Give at least one pair (left, right).")
    middle = np.asarray(on_plane, dtype=np.intp if not np.size(on_plane) else None)
    index_array("pairs", np.concatenate([array.ravel(), middle]), shape.size)
    (left, right), P, Q = array.T, len(array), len(middle)

    def rows(points: Array, plane: Array, want: bool) -> tuple[Array, Array | None, Array | None]:
        normal, off = plane[:3], points[right] @ plane[:3] + plane[3]
        residual = np.concatenate(
            [
                (points[right] - 2.0 * off[:, None] * normal - points[left]).ravel(),
                points[middle] @ normal + plane[3],
            ]
        )
        if not want:
            return residual, None, None
        by_points, by_plane = np.zeros((3 * P + Q, len(points), 3)), np.empty((3 * P + Q, 4))
        of_pairs = by_points[: 3 * P].reshape(P, 3, len(points), 3)
        of_pairs[np.arange(P), :, right] = np.eye(3) - 2.0 * np.outer(normal, normal)
        of_pairs[np.arange(P), :, left] = -np.eye(3)
        by_points[3 * P + np.arange(Q), middle] = normal
        mirrored = by_plane[: 3 * P].reshape(P, 3, 4)
        mirrored[:, :, :3] = -2.0 * (off[:, None, None] * np.eye(3) + normal[:, None] * points[right][:, None])
        mirrored[:, :, 3] = -2.0 * normal
        by_plane[3 * P :, :3], by_plane[3 * P :, 3] = points[middle], 1.0
        return residual, by_points, by_plane

    return shape_factor("symmetry", noise, shape, 3 * P + Q, rows, plane_key)
