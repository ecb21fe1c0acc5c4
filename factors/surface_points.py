"""Measured points on a vehicle's surface: LiDAR, RGB-D, stereo. Residual in metres, whitened.

    q = R' (p - t),    r = n_k . (q - m_k - B_k lambda) / sigma

for a point p of the camera frame and the patch k of the surface that is next to it (`factors.surface_patches`): centre
m_k + B_k lambda, normal n_k. Which patch that is, is held during a step, as visibility is.

Nobody says which points are the vehicle's: each is on its surface or anything else (`factors.mixture`). How probable
anything else is follows from the ray on which the point was measured. One that misses the vehicle may end anywhere; one
that would hit it seldom ends before it, on what hides it, and hardly ever far inside or behind it, through glass. A
patch that faces away from the sensor is not measured.

A point's energy is 0 where it is on the surface and log of the odds, a few nats, where it is anything else.
"""

from __future__ import annotations

from dataclasses import astuple, dataclass
from functools import cached_property
from typing import Any

import gtsam
import numpy as np
from numpy.typing import NDArray

from factors.guard import Evaluation
from factors.mixture import Form, mixture
from factors.native import native
from factors.sensed import SensedFactor
from factors.surface_patches import SPACING, SurfacePatches

Array = NDArray[np.float64]


@dataclass(frozen=True)
class PointOdds:
    """How probably a point is the vehicle's, and what else it may be.

    Attributes:
        vehicle: Probability that a point is the vehicle's.
        span: Metres over which a point that is anything else may lie.
        before: How dense such points are on rays that would hit the vehicle, before it; on other rays 1.
        through: The same inside and behind it.
        deepest: Metres inside the vehicle from which on a point is inside.
        core: Share of length, width and height of a cuboid that is inside the vehicle.
        reach: Metres along the surface from a patch's centre that it reaches,
        reach_sigma: and over which it ends.
    """

    vehicle: float
    span: float
    before: float
    through: float
    deepest: float
    core: float
    reach: float
    reach_sigma: float


@dataclass(frozen=True, eq=False)
class Match:
    """Which patch each point is next to, and how probable it is on it.

    Attributes:
        patch: (M,) indices of patches.
        right: (M,) densities of points on the surface, at it.
        wrong: (M,) densities of anything else.
    """

    patch: NDArray[np.intp]
    right: Array
    wrong: Array


@dataclass(frozen=True, eq=False)
class PointRows:
    """Points, and the surface that they may be on.

    Attributes:
        points: (M, 3) camera frame, metres.
        sigma: (M,) standard deviation of their distance from the surface, metres.
        origin: (3,) where the sensor is, camera frame.
        patches: The surface.
        size: (3,) length, width and height of the mean shape, metres.
        size_basis: (3, N) their change per unit of each coefficient.
        odds: How probable a point is the vehicle's.
        share: Share of the energy that counts: neighbouring points err alike, since the surface does.
    """

    points: Array
    sigma: Array
    origin: Array
    patches: SurfacePatches
    size: Array
    size_basis: Array
    odds: PointOdds
    share: float

    def match(self, rotation: Array, translation: Array, coefficients: Array) -> Match:
        """The patches next to the points at a pose and shape."""
        if self.compiled is not None:
            return Match(*self.compiled.match(rotation, translation, coefficients))
        patches, odds = self.patches, self.odds
        size = self.size + self.size_basis @ coefficients
        local, sensor = (self.points - translation) @ rotation, (self.origin - translation) @ rotation
        scale = (self.size / np.maximum(size, 0.1 * self.size))[[0, 2, 1]]  # to the mean shape's size
        near = patches.neighbours[patches.looked_up(local * scale)]  # (M, 12)
        centres, normals = patches.mean[near], patches.normal[near]
        facing = ((sensor * scale - centres) * normals).sum(axis=-1) > 0.0
        squares = np.where(facing, np.square((local * scale)[:, None] - centres).sum(axis=-1), np.inf)
        best = np.arange(len(local)), squares.argmin(axis=1)
        patch, normal = near[best].astype(np.intp), normals[best]
        away = local - patches.mean[patch] - np.tensordot(coefficients, patches.basis[:, patch], axes=1)
        off = (away * normal).sum(axis=1)
        along = np.sqrt(np.maximum(np.square(away).sum(axis=1) - off**2, 0.0))
        beyond = np.maximum(along - odds.reach, 0.0) / odds.reach_sigma
        right = np.where(facing[best], odds.vehicle * np.exp(-0.5 * np.square(beyond)), 0.0)
        wrong = (1.0 - odds.vehicle) * self._peak * self._elsewhere(local, sensor, size)
        return Match(patch, right, wrong)

    def __getstate__(self) -> dict[str, Any]:
        """What it is made of; another process compiles it again."""
        return {name: value for name, value in vars(self).items() if name != "compiled"}

    @property
    def kernel(self) -> Any:
        """The module of the compiled rows, or None."""
        return native("factors._points")

    @cached_property
    def compiled(self) -> Any:
        """The same rows compiled (`factors._points.Points`); None where there is no kernel."""
        kernel = self.kernel
        if kernel is None:
            return None
        patches, arrays = self.patches, (self.points, self.sigma, self.origin)
        return kernel.Points(
            *(np.ascontiguousarray(array, dtype=np.float64) for array in arrays),
            *patches.packed,
            SPACING,
            np.ascontiguousarray(self.size),
            np.ascontiguousarray(self.size_basis),
            np.array(astuple(self.odds)),
            self.share,
        )

    @property
    def _peak(self) -> Array:
        """(M,) density of anything else, relative to the peak of a right point's."""
        peak: Array = np.sqrt(2.0 * np.pi) * self.sigma / self.odds.span
        return peak

    def _elsewhere(self, local: Array, sensor: Array, size: Array) -> Array:
        """(M,) how dense points that are anything else are, by their rays through a cuboid in the vehicle."""
        length, width, height = size
        half = self.odds.core / 2.0 * np.array([length, height, width])
        middle = np.array([0.0, -height / 2.0, 0.0])
        ray = local - sensor
        ray = np.where(np.abs(ray) > 1e-9, ray, 1e-9)
        one, other = (middle - half - sensor) / ray, (middle + half - sensor) / ray
        enters, leaves = np.minimum(one, other).max(axis=1), np.maximum(one, other).min(axis=1)
        hits = leaves > np.maximum(enters, 0.0)
        inside = (np.minimum(leaves, 1.0) - np.maximum(enters, 0.0)) * np.linalg.norm(ray, axis=1)
        elsewhere = np.where(hits & (enters >= 1.0), self.odds.before, 1.0)
        return np.where(hits & (inside > self.odds.deepest), self.odds.through, elsewhere)

    def distances(
        self, match: Match, rotation: Array, translation: Array, coefficients: Array, *, want: bool
    ) -> tuple[Array, Array | None]:
        """Whitened distances (M,) from the patches of a match, and where wanted their derivative (M, 6 + N).

        By a turn about the object's axes, a shift along them, and the coefficients.
        """
        if self.compiled is not None:
            found: tuple[Array, Array | None] = self.compiled.distances(
                match.patch, rotation, translation, coefficients, want
            )
            return found
        patches, patch = self.patches, match.patch
        local = (self.points - translation) @ rotation
        basis, normal = patches.basis[:, patch], patches.normal[patch]
        off = ((local - patches.mean[patch] - np.tensordot(coefficients, basis, axes=1)) * normal).sum(axis=1)
        if not want:
            return off / self.sigma, None
        by_coefficients = -(basis * normal).sum(axis=-1).T
        jacobian = np.concatenate([np.cross(normal, local), -normal, by_coefficients], axis=1)
        return off / self.sigma, jacobian / self.sigma[:, None]

    def assess(self, match: Match, distances: Array) -> tuple[Array, float]:
        """Weights (M,) of the points, and their energy, nats."""
        weights, losses = mixture(match.right, match.wrong, np.square(distances))
        off = np.log(self.odds.vehicle + (1.0 - self.odds.vehicle) * self._peak) - np.log(match.right + match.wrong)
        outliers = match.right <= 0.0  # of which the mixture says nothing
        return weights, self.share * float((np.where(outliers, 0.0, losses) + off).sum())


class SurfacePointsFactor(SensedFactor):
    """Points on pose and lambda; matches and weights are set between steps.

    Attributes:
        rows: The points.
        weights: (M,) weights of the points there.
    """

    name = "points"

    def __init__(
        self, rows: PointRows, pose: int | Array, coefficients: int | Array, share: float = 1.0, common: float = 1.0
    ) -> None:
        """Bind the points to variables by their keys, or to constants: camera_T_object (4, 4), lambda (N,)."""
        super().__init__(pose, coefficients, len(rows.patches.basis), len(rows.points))
        self.rows, self._share, self.common_factor = rows, share * rows.share, common
        self._share_of_image = share
        self._matches = 0
        if rows.compiled is not None:
            self._source = rows.kernel.PointSource(rows.compiled, self._share)
        self._matched: tuple[tuple[Array, Array, Array], Match] | None = None
        self.weights = np.zeros(len(rows.points))

    def look(self, values: gtsam.Values, *, hold: bool = False) -> None:
        """Match the points at the values and weigh them.

        Near where they were matched last they keep their patches, and where that is requested.
        """
        state = self.state(values)
        near = min(NEAR * NEARER**self._matches, NEAREST)
        if self._matched is None or not (hold or _alike(self._matched[0], state, near)):
            self._matched, self._matches = (state, self.rows.match(*state)), self._matches + 1
        match = self._matched[1]
        self.weights, _ = self.rows.assess(match, self.rows.distances(match, *state, want=False)[0])
        if self._source is not None:
            self._source.tell(match.patch, match.right, match.wrong, self.weights)

    def tell(self, form: Form, common_factor: float = 1.0) -> None:
        """Set the form, and by how much less the points say with `Form.WEIGHTED`."""
        super().tell(form, common_factor)
        if self._source is not None:
            self._source.form, self._source.common = int(form), common_factor

    def energy(self, values: gtsam.Values) -> float:
        """The energy at the values with the patches of their own, nats; what is set stays as it is."""
        state = self.state(values)
        match = self.rows.match(*state)
        distances, _ = self.rows.distances(match, *state, want=False)
        return self._share_of_image * self.rows.assess(match, distances)[1]

    def __call__(self, values: gtsam.Values, want_jacobian: bool) -> Evaluation:
        """The rows at the values."""
        if self._matched is None:
            self.look(values)
        assert self._matched is not None
        match = self._matched[1]
        distances, jacobian = self.rows.distances(match, *self.state(values), want=want_jacobian)
        return self._robust(self.weights, (match.right, match.wrong), distances, jacobian, share=self._share)


NEAR = 0.003
"""Metres, radians and a tenth of a coefficient: points keep their patches where a vehicle moves by less at first."""

NEARER, NEAREST = 1.5, 0.05
"""By how much that grows with each match, and to what: matches that lead to and fro come to an end."""


def _alike(one: tuple[Array, Array, Array], other: tuple[Array, Array, Array], near: float) -> bool:
    """Whether two poses and shapes differ by so little that points keep their patches."""
    turn, shift, change = (float(np.abs(a - b).max(initial=0.0)) for a, b in zip(one, other, strict=True))
    return max(turn, shift, 0.1 * change) < near
