"""Laplacian regulariser: E_lap of the paper's section III-C, in metres.

    delta_i(X) = X_i - sum_j a_ij X_j,    w_ij = exp(-||X_i - X_j||^2),    j in the neighbourhood of i

Normalised (the default): a_ij = w_ij / sum_j w_ij, so that delta_i is the distance to the weighted centroid of the
neighbours, as the paper's text says; it does not depend on where the origin is. Literal: a_ij = w_ij, as the paper's
formula is printed. Those weights do not sum to one (at a metre's distance each is 0.37, at two 0.02), so that the sum
is no centroid: with few or distant neighbours the term pulls X_i towards the object's origin, with many close ones away
from it, and a shift of the object frame changes its value.

Either way a zero residual at the plain delta_i would be a car shrunk to a point. By default the residual is therefore
taken relative to the mean shape, delta_i(X) - delta_i(mean): every keypoint keeps its position among its neighbours,
and the term vanishes at lambda = 0. The plain form, the paper's, is an option.

The weights change with the shape; the Jacobian holds their derivative too.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import gtsam
import numpy as np
from numpy.typing import NDArray

from factors.arrays import Array
from factors.checks import index_array
from factors.errors import InvalidInputError
from factors.noise import Noise
from factors.shape import LinearShape
from factors.shape_factor import ShapeContext, ShapeTerm, shape_factor


class LaplacianTerm(ShapeTerm):
    """One factor; the paper's own form on request."""

    name = "laplacian"

    def applies(self, about: ShapeContext) -> bool:
        """Whether keypoints have neighbours."""
        return any(about.neighbours)

    def factors(self, about: ShapeContext) -> list[gtsam.NonlinearFactor]:
        """One factor."""
        sigma, ours = about.settings.laplacian_sigma, not about.settings.literal_laplacian
        return [laplacian_factor(about.shape, about.neighbours, sigma, normalised=ours, relative_to_mean=ours)]


def laplacian_factor(
    shape: LinearShape,
    neighbours: Sequence[Sequence[int]],
    noise: Noise,
    *,
    normalised: bool = True,
    relative_to_mean: bool = True,
) -> gtsam.CustomFactor:
    """Every keypoint stays where it is among its neighbours: 3 rows per keypoint that has any, metres.

    Args:
        shape: The keypoints.
        neighbours: For each of the K keypoints its neighbours; none for a keypoint without a term.
        noise: Noise model of that many rows, or sigma in metres.
        normalised: Whether the weights are scaled to sum to one; False takes the paper's formula literally.
        relative_to_mean: Whether the residual is relative to the mean shape's own; False as in the paper.

    Raises:
        InvalidInputError: There are not K neighbourhoods, all are empty, or one has an index out of range, repeated,
            or the keypoint's own.
    """
    if len(neighbours) != shape.size:
        raise InvalidInputError(
            "neighbours", f"{len(neighbours)} neighbourhoods", f"Give one for each of {shape.size}."
        )
    for i, near in enumerate(neighbours):
        if len(near) and i in index_array(f"neighbours[{i}]", near, shape.size):
            raise InvalidInputError(f"neighbours[{i}]", list(near), "Leave the keypoint itself out.")
    centres = np.array([i for i, near in enumerate(neighbours) if len(near)], dtype=np.intp)
    if not len(centres):
        raise InvalidInputError("neighbours", "no neighbours", "Give at least one keypoint a neighbour.")
    counts = [len(neighbours[i]) for i in centres]
    edges = _Edges(
        centres=centres,
        rows=np.repeat(np.arange(len(centres)), counts),
        ends=np.concatenate([np.asarray(neighbours[i], dtype=np.intp) for i in centres]),
        starts=np.concatenate([[0], np.cumsum(counts)[:-1]]),
        normalised=normalised,
    )
    reference = edges.coordinates(shape.mean)[0] if relative_to_mean else np.zeros((len(centres), 3))

    def rows(points: Array, _plane: Array, want: bool) -> tuple[Array, Array | None, None]:
        delta, *rest = edges.coordinates(points)
        residual = (delta - reference).ravel()
        return residual, edges.gradient(points, *rest) if want else None, None

    return shape_factor("Laplacian", noise, shape, 3 * len(centres), rows)


@dataclass(frozen=True, slots=True)
class _Edges:
    """The neighbourhoods of M keypoints as E directed edges, sorted by keypoint."""

    centres: NDArray[np.intp]  # (M,) the keypoints
    rows: NDArray[np.intp]  # (E,) which of the M each edge belongs to
    ends: NDArray[np.intp]  # (E,) the neighbour at its end
    starts: NDArray[np.intp]  # (M,) first edge of each keypoint
    normalised: bool  # whether weights are scaled to sum to one

    def coordinates(self, points: Array) -> tuple[Array, Array, Array, Array]:
        """Differential coordinates delta (M, 3), weights a (E,), edges X_i - X_j (E, 3) and centroids (M, 3)."""
        ends = points[self.ends]
        edges = points[self.centres[self.rows]] - ends
        exponents = -np.einsum("ij,ij->i", edges, edges)
        if self.normalised:  # a common factor cancels: taking the largest out keeps far neighbours from underflowing
            exponents -= np.maximum.reduceat(exponents, self.starts)[self.rows]
        weights = np.exp(exponents)
        if self.normalised:
            weights /= np.add.reduceat(weights, self.starts)[self.rows]
        centroids = np.add.reduceat(weights[:, None] * ends, self.starts)
        return points[self.centres] - centroids, weights, edges, centroids

    def gradient(
        self,
        points: Array,
        weights: Array,
        edges: Array,
        centroids: Array,
    ) -> Array:
        """(3M, K, 3) derivative of delta with respect to X.

        With y_ij = X_j - centroid_i (normalised) or X_j (literal), the derivative of the weighted sum is
        a_ij (I + 2 y_ij (X_i - X_j)') with respect to X_j, and -2 sum_j a_ij y_ij (X_i - X_j)' with respect to X_i.
        """
        arms = points[self.ends] - centroids[self.rows] if self.normalised else points[self.ends]
        moved = 2.0 * weights[:, None, None] * arms[:, :, None] * edges[:, None, :]
        eye = np.eye(3)
        gradient = np.zeros((len(self.centres), 3, len(points), 3))
        # Indices on both sides of a slice bring the indexed axis to the front: (E, 3, 3) and (M, 3, 3) as wanted.
        gradient[self.rows, :, self.ends] = -(weights[:, None, None] * eye + moved)
        gradient[np.arange(len(self.centres)), :, self.centres] = eye + np.add.reduceat(moved, self.starts)
        return gradient.reshape(3 * len(self.centres), len(points), 3)
