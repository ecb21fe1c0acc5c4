"""Silhouette term: the outline of the projected surface is the edge of the mask. In pixels, whitened.

    r_k = D(pi(R x_k(lambda) + t)) / sigma,    r'_k = d_k . (pi(R x_k(lambda) + t) - m_k) / sigma

D is the signed distance of a pixel from the mask's outline, negative inside; x_k the surface's vertex that is farthest
in the image in the direction d_k, m_k the mask's point that is. So each vertex of the convex hull of the projection is
on the outline, and no part of the mask is beyond. Which vertices these are is held during a step, as visibility is.

What is outside the image, or about where something hides the vehicle, says nothing; the rest is right or wrong
(`factors.mixture`), since masks have holes and lack mirrors.
"""

from __future__ import annotations

from dataclasses import astuple, dataclass
from functools import cached_property
from typing import Any

import gtsam
import numpy as np
from numpy.typing import NDArray

from factors.arrays import Array
from factors.distance_field import DistanceField
from factors.guard import Evaluation
from factors.mixture import mixture
from factors.native import KernelRows
from factors.projection import LEAST_DEPTH, by_pose, pixel_jacobian, project
from factors.sensed import SensedFactor


@dataclass(frozen=True)
class SilhouetteOdds:
    """How probably a vertex of the outline is on the mask's, and where else it may be."""

    right: float  # probability that it is
    span: float  # pixels over which the others lie
    hidden: float  # pixels about what hides the vehicle within which outlines say nothing
    border: float  # the same of the image's border
    independent: float  # as how many rows all count at most: neighbours err alike


@dataclass(frozen=True, eq=False)
class SilhouetteRows(KernelRows):
    """A mask, and the surface whose outline it has."""

    KERNEL = "factors._silhouette"

    field: DistanceField  # distance from the mask's outline
    hides: DistanceField | None  # the same of what hides the vehicle, or None
    matrix: Array  # (3, 3) camera matrix
    image_size: tuple[int, int] | None  # width and height, pixels, or None
    mean: Array  # (P, 3) vertices that can be on an outline, of the mean shape, metres
    basis: Array  # (N, P, 3) their change per unit of each coefficient
    directions: Array  # (2, M) unit vectors in the image
    farthest: Array  # (M, 2) the mask's farthest points there, pixels
    sigma: float  # standard deviation of the mask's outline, pixels
    odds: SilhouetteOdds  # how probably vertices are on it

    def match(self, rotation: Array, translation: Array, coefficients: Array) -> tuple[NDArray[np.intp], Array]:
        """The farthest vertices (M,) in the directions, and which rows (2 M,) say something, as 1 or 0."""
        if self.compiled is not None:
            return self.compiled.match(rotation, translation, coefficients)
        vertices = self.mean + np.tensordot(coefficients, self.basis, axes=1)
        pixels, _, depths = project(self.matrix, rotation, translation, vertices)
        farthest = (pixels @ self.directions).argmax(axis=0)
        count = len(farthest)
        says = np.zeros(2 * count)
        _, first = np.unique(farthest, return_index=True)
        says[first], says[count:] = self._says(pixels[farthest])[first], self._mask_says
        says[np.tile(depths[farthest] <= LEAST_DEPTH, 2)] = 0.0
        return farthest, says

    @cached_property
    def compiled(self) -> Any:
        """The same rows compiled (`factors._silhouette.Silhouette`); None where there is no kernel."""
        if self.kernel is None:
            return None
        field, hides = ((one.corner, one.distance) if one is not None else None for one in (self.field, self.hides))
        return self.kernel.Silhouette(
            field,
            hides,
            np.ascontiguousarray(self.matrix, dtype=np.float64),
            self.image_size,
            np.ascontiguousarray(self.mean),
            np.ascontiguousarray(self.basis).reshape(len(self.basis), -1),
            np.ascontiguousarray(self.directions.T),
            np.ascontiguousarray(self.farthest),
            self.sigma,
            astuple(self.odds),
        )

    @cached_property
    def _mask_says(self) -> Array:
        return self._says(self.farthest)

    def _says(self, pixels: Array) -> Array:
        """(M,) whether outlines at pixels (M, 2) say something, as 1 or 0."""
        says = np.ones(len(pixels))
        if self.image_size is not None:
            border = self.odds.border
            inside = (pixels >= border) & (pixels <= np.array(self.image_size) - 1.0 - border)
            says[~inside.all(axis=1)] = 0.0
        if self.hides is not None:
            says[self.hides.at(pixels)[0] < self.odds.hidden] = 0.0
        return says

    def distances(
        self, vertices: NDArray[np.intp], rotation: Array, translation: Array, coefficients: Array, *, want: bool
    ) -> tuple[Array, Array | None]:
        """Whitened residuals (2 M,) of vertices (M,), and where wanted their derivative (2 M, 6 + N).

        By a turn about the object's axes, a shift along them, and the coefficients.
        """
        if self.compiled is not None:
            return self.compiled.distances(vertices, rotation, translation, coefficients, want)
        basis = self.basis[:, vertices]
        points = self.mean[vertices] + np.tensordot(coefficients, basis, axes=1)
        pixels, camera, _ = project(self.matrix, rotation, translation, points)
        off, slope = self.field.at(pixels)
        beyond = ((pixels - self.farthest) * self.directions.T).sum(axis=1)
        residual = np.concatenate([off, beyond]) / self.sigma
        if not want:
            return residual, None
        both = np.stack([slope, self.directions.T], axis=1)  # (M, 2, 2) by the pixel
        by_turn, by_shift = by_pose(points, rotation, both @ pixel_jacobian(self.matrix, camera))
        by_shape = np.einsum("nmc,mrc->mrn", basis, by_shift)
        jacobian = np.concatenate([by_turn, by_shift, by_shape], axis=2)
        return residual, jacobian.transpose(1, 0, 2).reshape(len(residual), -1) / self.sigma

    def densities(self, says: Array) -> tuple[Array, Array]:
        """(2 M,) densities of right rows, at the outline, and of wrong ones."""
        peak = np.sqrt(2.0 * np.pi) * self.sigma / self.odds.span
        return self.odds.right * says, np.full(len(says), (1.0 - self.odds.right) * peak)

    def share(self, says: Array) -> float:
        """Share of the energy that counts."""
        return min(1.0, self.odds.independent / max(float(says.sum()), 1.0))


class SilhouetteFactor(SensedFactor):
    """A silhouette on pose and lambda; the outline's vertices and weights are set between steps.

    Attributes:
        rows: The silhouette.
        weights: (2 M,) weights of the rows.
    """

    name = "mask"

    def __init__(self, rows: SilhouetteRows, pose: int | Array, coefficients: int | Array, share: float = 1.0) -> None:
        """Bind it to variables by their keys, or to constants: camera_T_object (4, 4), lambda (N,)."""
        super().__init__(pose, coefficients, len(rows.basis), 2 * rows.directions.shape[1])
        self.rows, self._share_of_image = rows, share
        if rows.compiled is not None:
            self._source = rows.kernel.SilhouetteSource(rows.compiled, share)
        self._matched: tuple[NDArray[np.intp], Array] | None = None  # vertices, and which rows say something
        self.weights = np.zeros(0)

    def look(self, values: gtsam.Values, *, hold: bool = False) -> None:
        """Find the outline's vertices at the values, and weigh them."""
        state = self.state(values)
        if self._source is not None:
            pose = np.concatenate([state[0].ravel(), state[1]])
            self.judged(self._source.look(pose, np.ascontiguousarray(state[2]), not hold))
            return
        if self._matched is None or not hold:
            self._matched = self.rows.match(*state)
        vertices, says = self._matched
        off, _ = self.rows.distances(vertices, *state, want=False)
        self.weights, _ = mixture(*self.rows.densities(says), np.square(off))

    def judged(self, found: Array) -> None:
        """Take over the weights."""
        self.weights = found

    def energy(self, values: gtsam.Values) -> float:
        """The energy at the values with the vertices of their own, nats; what is set stays as it is."""
        state = self.state(values)
        vertices, says = self.rows.match(*state)
        off, _ = self.rows.distances(vertices, *state, want=False)
        _, losses = mixture(*self.rows.densities(says), np.square(off))
        return self._share_of_image * self.rows.share(says) * float(losses.sum())

    def __call__(self, values: gtsam.Values, want_jacobian: bool) -> Evaluation:
        """The rows at the values."""
        if not len(self.weights):
            self.look(values)
        matched = self._matched if self._source is None else self._source.matched
        assert matched is not None
        vertices, says = matched
        off, jacobian = self.rows.distances(vertices, *self.state(values), want=want_jacobian)
        share = self._share_of_image * self.rows.share(says)
        return self._robust(self.weights, self.rows.densities(says), off, jacobian, share=share)
