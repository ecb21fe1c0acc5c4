"""Distance of measured points (LiDAR, RGB-D, stereo) from a vehicle's surface. Residual in metres, whitened.

    q = R' (p - t),    r = n_k . (q - m_k - B_k lambda) / sigma

for a point p of the camera frame and the patch k of the surface that is next to it (`factors.surface_patches`): centre
m_k + B_k lambda, normal n_k. Which patch that is, is held during a step, as visibility is.

Nobody says which points are the vehicle's: each is on its surface or anything else (`factors.mixture`). How probable
anything else is follows from the ray on which the point was measured. One that misses the vehicle may end anywhere; one
that would hit it seldom ends before it, on what hides it, and hardly ever far inside or behind it, through glass. A
patch that faces away from the sensor is not measured. Points that go on in the plane of a side beyond its edges are
rare too: they are those of a wall, and so are the others then.

A point's energy is 0 where it is on the surface and log of the odds, a few nats, where it is anything else.

Points of a depth map are far more uncertain along their rays than across them: `along` of them beside `sigma` all
round. Such a point is on the patch k that its ray meets, and with the ray's direction u at the patch

    r = n_k . (q - m_k - B_k lambda) / sqrt(sigma^2 + (n_k . u along)^2)

All points of an image may share an error as well, with two variables (a, b): of the depth, z' = exp(a) z + b, or of the
inverse depth, 1 / z' = exp(a) / z + b (`Shared`).
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from enum import IntEnum
from functools import cached_property
from typing import Any

import gtsam
import numpy as np
from numpy.typing import NDArray

from factors.arrays import Array
from factors.guard import Evaluation
from factors.mixture import mixture
from factors.native import KernelRows
from factors.sensed import SensedFactor
from factors.surface_patches import SPACING, SurfacePatches


class Shared(IntEnum):
    """What the two variables are that all points of an image share."""

    NONE = 0
    DEPTH = 1
    INVERSE = 2


SPREAD = 3.0
"""Standard deviations along a ray over which what is anything else is spread at least, beside `PointOdds.span`."""

STEPS = 3
"""Patches that are looked at on the way of a ray to the surface."""

LEAST_COSINE, LONGEST_STEP = 0.05, 1.0
"""Of the angle between ray and normal, below which a patch is not met; metres of such a step."""

SOFTNESS = 1.7
"""Of a logistic function that is about a normal distribution's."""

FARTHEST, OUTSIDE = 5.0, 0.25
"""Standard deviations beyond a patch, and metres of mirrors beyond the cuboid, from which on a point is on no patch."""

LEAST_RATIO = 0.05
"""Of a point's depth to what was measured."""

ON_SIDE, CLEAR, LOW = 0.2, 0.15, 0.3
"""Metres from a side's plane at which points are on it; beyond its edges, where they are not the vehicle's; and above
the ground, below which they may be the ground's."""


@dataclass(frozen=True)
class PointOdds:
    """How probably a point is the vehicle's, and what else it may be."""

    vehicle: float  # probability that a point is the vehicle's
    span: float  # metres over which a point that is anything else may lie
    before: float  # how dense such points are on rays that would hit the vehicle, before it; on other rays 1
    through: float  # the same inside and behind it
    deepest: float  # metres inside the vehicle from which on a point is inside
    core: float  # share of length, width and height of a cuboid that is inside the vehicle
    reach: float  # metres along the surface from a patch's centre that it reaches,
    reach_sigma: float  # and over which it ends
    beyond: float  # how dense points that are anything else are where a side would go on beyond its edges
    edge: float  # metres beyond the edges up to which they are looked at

    @cached_property
    def numbers(self) -> Array:
        """(10,) all of them, in this order."""
        return np.array([getattr(self, field.name) for field in fields(self)])


NOTHING_SHARED = np.zeros(2)
"""What points share where nothing is known of it."""


@dataclass(frozen=True, eq=False)
class Match:
    """Which patch each point is next to, and how probable it is on it."""

    patch: NDArray[np.intp]  # (M,) indices of patches
    right: Array  # (M,) densities of points on the surface, at it
    wrong: Array  # (M,) densities of anything else
    sigma: Array  # (M,) standard deviations of their distances from the patches, metres


@dataclass(frozen=True, eq=False)
class PointRows(KernelRows):
    """Points, and the surface that they may be on."""

    KERNEL = "factors._points"

    points: Array  # (M, 3) camera frame, metres
    sigma: Array  # (M,) standard deviation of their distance from the surface, metres
    origin: Array  # (3,) where the sensor is, camera frame
    patches: SurfacePatches
    size: Array  # (3,) length, width and height of the mean shape, metres
    size_basis: Array  # (3, N) their change per unit of each coefficient
    odds: PointOdds  # how probable a point is the vehicle's
    share: float  # share of the energy that counts: neighbouring points err alike, since the surface does
    # (M,) standard deviation along the rays from the origin, metres; 0 of points that have none of their own
    along: Array
    shared: Shared = Shared.NONE  # what the variables are that all of them share

    def match(self, rotation: Array, translation: Array, coefficients: Array, shared: Array = NOTHING_SHARED) -> Match:
        """The patches next to the points, or that their rays meet, at a pose, a shape and what they share (2,)."""
        if self.compiled is not None:
            return Match(*self.compiled.match(rotation, translation, coefficients, shared))
        patches, odds = self.patches, self.odds
        size = self.size + self.size_basis @ coefficients
        local, sensor = (self.placed(shared) - translation) @ rotation, (self.origin - translation) @ rotation
        scale = (self.size / np.maximum(size, 0.1 * self.size))[[0, 2, 1]]  # to the mean shape's size
        unit = local - sensor
        unit = unit / np.maximum(np.linalg.norm(unit, axis=1), 1e-9)[:, None]
        met = local
        if self.along.any():
            traced = self._traced(sensor, unit, scale, size, coefficients)
            met = np.where(self.along[:, None] > 0.0, traced, local)
        patch, facing = self._nearest(met, sensor, scale)
        near = (self.along > 0.0) | self._is_near(local, size)
        patch, facing = np.where(near, patch, 0), near & facing
        normal = patches.normal[patch]
        away = met - self._centres(patch, coefficients)
        off = (away * normal).sum(axis=1)
        tangent = np.sqrt(np.maximum(np.square(away).sum(axis=1) - off**2, 0.0))
        beyond = np.maximum(tangent - odds.reach, 0.0) / odds.reach_sigma
        cosine = np.abs((unit * normal).sum(axis=1))
        sigma = np.sqrt(self.sigma**2 + (self.along * cosine) ** 2)
        density = np.where(self.along > 0.0, cosine * self._spread / sigma, 1.0)
        right = np.where(facing, odds.vehicle * np.exp(-0.5 * np.square(beyond)) * density, 0.0)
        wrong = (1.0 - odds.vehicle) * self._peak * self._elsewhere(local, sensor, size)
        return Match(patch, right, wrong, sigma)

    def placed(self, shared: Array) -> Array:
        """(M, 3) the points by what they share."""
        if self.shared is Shared.NONE:
            return self.points
        return self.points * self._ratio(shared)[:, None]

    def _ratio(self, shared: Array) -> Array:
        """(M,) depths by what the points share, as a share of the measured ones."""
        scale, depth = np.exp(shared[0]), self.points[:, 2]
        if self.shared is Shared.DEPTH:
            return np.asarray(np.maximum(scale + shared[1] / depth, LEAST_RATIO))
        return np.asarray(1.0 / np.maximum(scale + shared[1] * depth, LEAST_RATIO))

    def _centres(self, patch: NDArray[np.intp], coefficients: Array) -> Array:
        """(M, 3) centres of patches at a shape."""
        return self.patches.mean[patch] + np.tensordot(coefficients, self.patches.basis[:, patch], axes=1)

    def _nearest(self, local: Array, sensor: Array, scale: Array) -> tuple[NDArray[np.intp], NDArray[np.bool_]]:
        """(M,) the patches next to points in the object frame, of those that face the sensor; whether these do."""
        patches = self.patches
        near = patches.neighbours[patches.looked_up(local * scale)]  # (M, 12)
        centres, normals = patches.mean[near], patches.normal[near]
        facing = ((sensor * scale - centres) * normals).sum(axis=-1) > 0.0
        squares = np.where(facing, np.square((local * scale)[:, None] - centres).sum(axis=-1), np.inf)
        best = np.arange(len(local)), squares.argmin(axis=1)
        return near[best].astype(np.intp), facing[best]

    def _is_near(self, local: Array, size: Array) -> NDArray[np.bool_]:
        """(M,) which points in the object frame are so near the vehicle's cuboid that they may be on a patch."""
        half, middle = size[[0, 2, 1]] / 2.0, np.array([0.0, -size[2] / 2.0, 0.0])
        reach = self.odds.reach + FARTHEST * self.odds.reach_sigma + OUTSIDE
        return (np.abs(local - middle) <= half + reach).all(axis=1)

    def _traced(self, sensor: Array, unit: Array, scale: Array, size: Array, coefficients: Array) -> Array:
        """(M, 3) where rays meet the surface, object frame; of one that misses it, where it is near."""
        half, middle = size[[0, 2, 1]] / 2.0, np.array([0.0, -size[2] / 2.0, 0.0])
        enters, leaves = _crossing(sensor, unit, middle, half)
        at = np.where(leaves > np.maximum(enters, 0.0), np.maximum(enters, 0.0), unit @ (middle - sensor))
        for _ in range(STEPS):
            place = sensor + at[:, None] * unit
            patch, facing = self._nearest(place, sensor, scale)
            normal = self.patches.normal[patch]
            slope = (normal * unit).sum(axis=1)
            off = ((place - self._centres(patch, coefficients)) * normal).sum(axis=1)
            step = np.where(facing & (slope < -LEAST_COSINE), -off / np.minimum(slope, -LEAST_COSINE), 0.0)
            at = at + np.clip(step, -LONGEST_STEP, LONGEST_STEP)
        return np.asarray(sensor + at[:, None] * unit)

    @cached_property
    def compiled(self) -> Any:
        """The same rows compiled (`factors._points.Points`); None where there is no kernel."""
        kernel = self.kernel
        if kernel is None:
            return None
        patches, arrays = self.patches, (self.points, self.sigma, self.along, self.origin)
        return kernel.Points(
            *(np.ascontiguousarray(array, dtype=np.float64) for array in arrays),
            *patches.packed,
            SPACING,
            np.ascontiguousarray(self.size),
            np.ascontiguousarray(self.size_basis),
            self.odds.numbers,
            self.share,
            int(self.shared),
        )

    @property
    def _spread(self) -> Array:
        """(M,) standard deviation of a point along a ray that meets the surface square on, metres."""
        return np.asarray(np.hypot(self.sigma, self.along))

    @property
    def _peak(self) -> Array:
        """(M,) density of anything else, relative to the peak of a right point's."""
        return np.sqrt(2.0 * np.pi) * self._spread / np.maximum(self.odds.span, SPREAD * self.along)

    def _elsewhere(self, local: Array, sensor: Array, size: Array) -> Array:
        """(M,) how dense points that are anything else are, by their rays through a cuboid in the vehicle."""
        length, width, height = size
        half = self.odds.core / 2.0 * np.array([length, height, width])
        middle = np.array([0.0, -height / 2.0, 0.0])
        ray = local - sensor
        far = np.linalg.norm(ray, axis=1)
        enters, leaves = _crossing(sensor, ray, middle, half)
        hits = leaves > np.maximum(enters, 0.0)
        inside = (np.minimum(leaves, 1.0) - np.maximum(enters, 0.0)) * far
        sharp = np.where((self.along == 0.0) & self._goes_on(local, sensor, size), self.odds.beyond, 1.0)
        sharp = np.where(hits, np.where(enters >= 1.0, self.odds.before, 1.0), sharp)
        sharp = np.where(hits & (inside > self.odds.deepest), self.odds.through, sharp)
        if not self.along.any():
            return sharp
        noise = np.maximum(self.along, 1e-9) / SOFTNESS
        past = (1.0 - np.where(hits, enters, 0.0)) * far
        before = 1.0 / (1.0 + np.exp(np.clip(past / noise, -50.0, 50.0)))
        deep = 1.0 / (1.0 + np.exp(np.clip((self.odds.deepest - past) / noise, -50.0, 50.0)))
        soft = 1.0 + before * (self.odds.before - 1.0) + deep * (self.odds.through - 1.0)
        return np.where((self.along > 0.0) & hits, soft, sharp)

    def _goes_on(self, local: Array, sensor: Array, size: Array) -> NDArray[np.bool_]:
        """(M,) which points are on the plane of a side that the sensor sees, just beyond that side's edges."""
        half, height, found = size[[0, 2, 1]] / 2.0, -local[:, 1], np.zeros(len(local), dtype=np.bool_)
        near = (height > LOW) & (height < size[2] + self.odds.edge)
        for side, other in ((0, 2), (2, 0)):
            plane, past = np.copysign(half[side], sensor[side]), np.abs(local[:, other]) - half[other]
            on = (np.abs(sensor[side]) > half[side]) & (np.abs(local[:, side] - plane) < ON_SIDE)
            found |= on & (past < self.odds.edge) & ((past > CLEAR) | (height > size[2] + CLEAR))
        return found & near

    def distances(
        self,
        match: Match,
        rotation: Array,
        translation: Array,
        coefficients: Array,
        shared: Array = NOTHING_SHARED,
        *,
        want: bool,
    ) -> tuple[Array, Array | None]:
        """Whitened distances (M,) from the patches of a match, and where wanted their derivative (M, 6 + N + C).

        By a turn about the object's axes, a shift along them, the coefficients, and the C numbers that points share.
        """
        if self.compiled is not None:
            return self.compiled.distances(match.patch, match.sigma, rotation, translation, coefficients, shared, want)
        patches, patch = self.patches, match.patch
        local = (self.placed(shared) - translation) @ rotation
        basis, normal = patches.basis[:, patch], patches.normal[patch]
        off = ((local - self._centres(patch, coefficients)) * normal).sum(axis=1)
        if not want:
            return off / match.sigma, None
        by_coefficients = -(basis * normal).sum(axis=-1).T
        parts = [np.cross(normal, local), -normal, by_coefficients]
        if self.shared is not Shared.NONE:
            ratio, depth, scale = self._ratio(shared), self.points[:, 2], np.exp(shared[0])
            by_ratio = ((self.points @ rotation) * normal).sum(axis=1)
            if self.shared is Shared.DEPTH:
                by_shared = np.stack([np.full(len(depth), scale), 1.0 / depth], axis=1)
            else:
                by_shared = -(ratio**2)[:, None] * np.stack([np.full(len(depth), scale), depth], axis=1)
            parts.append(by_ratio[:, None] * by_shared)
        return off / match.sigma, np.concatenate(parts, axis=1) / match.sigma[:, None]

    def assess(self, match: Match, distances: Array) -> tuple[Array, float]:
        """Weights (M,) of the points, and their energy, nats."""
        if self.compiled is not None:
            return self.compiled.assess(match.right, match.wrong, distances)
        weights, losses = mixture(match.right, match.wrong, np.square(distances))
        off = np.log(self.odds.vehicle + (1.0 - self.odds.vehicle) * self._peak) - np.log(match.right + match.wrong)
        outliers = match.right <= 0.0  # of which the mixture says nothing
        return weights, self.share * float((np.where(outliers, 0.0, losses) + off).sum())


State = tuple[Array, Array, Array, Array]
"""Rotation (3, 3), translation (3,), coefficients (N,), and what points share (2,)."""


class SurfacePointsFactor(SensedFactor):
    """Points on pose and lambda, and on what all points of the image share; matches and weights are set between steps.

    Attributes:
        rows: The points.
        weights: (M,) weights of the points there.
    """

    def __init__(
        self,
        rows: PointRows,
        pose: int | Array,
        coefficients: int | Array,
        shared: int | Array = NOTHING_SHARED,
        share: float = 1.0,
        name: str = "points",
    ) -> None:
        """Bind the points to variables by their keys, or to constants.

        Args:
            pose: camera_T_object, or (4, 4).
            coefficients: lambda, or (N,).
            shared: What the points share, or (2,); not used where they share nothing.
            share: Share of its information that the observation has.
            name: What measured them.
        """
        super().__init__(pose, coefficients, len(rows.patches.basis), len(rows.points), self._more_of(rows, shared))
        self.rows, self.name, self._share = rows, name, share * rows.share
        self._share_of_image = share
        self._matches = 0
        if rows.compiled is not None:
            self._source = rows.kernel.PointSource(rows.compiled, self._share)
        self._matched: tuple[State, Match] | None = None  # where nothing is compiled
        self._shares, self._looked = NOTHING_SHARED, False  # by the points, where they were looked at last
        self.weights = np.zeros(len(rows.points))

    @staticmethod
    def _more_of(rows: PointRows, shared: int | Array) -> list[tuple[int | Array, int]]:
        """The further variables, with their numbers."""
        return [] if rows.shared is Shared.NONE else [(shared, 2)]

    def _state(self, values: gtsam.Values) -> State:
        """Rotation, translation, coefficients and what points share at the values."""
        shared = self.others(values)
        return *self.state(values), shared[0] if shared else NOTHING_SHARED

    def look(self, values: gtsam.Values, *, hold: bool = False) -> None:
        """Match the points at the values and weigh them.

        Near where they were matched last they keep their patches, and where that is requested.
        """
        state = self._state(values)
        if self._source is not None:
            rotation, translation, coefficients, shared = state
            pose = np.concatenate([rotation.ravel(), translation])
            self.judged(self._source.look(pose, np.ascontiguousarray(coefficients), shared, not hold))
            return
        near = min(NEAR * NEARER**self._matches, NEAREST)
        if self._matched is None or not (hold or _alike(self._matched[0], state, near)):
            self._matched, self._matches = (state, self.rows.match(*state)), self._matches + 1
        match = self._matched[1]
        self.weights, _ = self.rows.assess(match, self.rows.distances(match, *state, want=False)[0])
        self._shares, self._looked = self._matched[0][3], True

    def judged(self, found: Array) -> None:
        """Take over the weights, and what the points share."""
        self.weights, self._shares, self._looked = found[:-2], found[-2:], True

    def _match_at(self, values: gtsam.Values) -> Match:
        """What the points are matched to; by the values where they were not looked at yet."""
        if not self._looked:
            self.look(values)
        if self._source is not None:
            return Match(*self._source.matched)
        assert self._matched is not None
        return self._matched[1]

    @property
    def points(self) -> Array:
        """(M, 3) the points in the camera's frame, by what they share where they were looked at last."""
        return self.rows.placed(self._shares)

    def energy(self, values: gtsam.Values) -> float:
        """The energy at the values with the patches of their own, nats; what is set stays as it is."""
        state = self._state(values)
        match = self.rows.match(*state)
        distances, _ = self.rows.distances(match, *state, want=False)
        return self._share_of_image * self.rows.assess(match, distances)[1]

    def __call__(self, values: gtsam.Values, want_jacobian: bool) -> Evaluation:
        """The rows at the values."""
        match = self._match_at(values)
        distances, jacobian = self.rows.distances(match, *self._state(values), want=want_jacobian)
        return self._robust(self.weights, (match.right, match.wrong), distances, jacobian, share=self._share)


NEAR = 0.003
"""Metres, radians and a tenth of a coefficient: points keep their patches where a vehicle moves by less at first."""

NEARER, NEAREST = 1.5, 0.05
"""By how much that grows with each match, and to what: matches that lead to and fro come to an end."""


def _alike(one: State, other: State, near: float) -> bool:
    """Whether two poses and shapes differ by so little that points keep their patches."""
    for a, b, times in zip(one, other, (1.0, 1.0, 0.1, 1.0), strict=True):
        change = (a - b).ravel()
        if times**2 * np.vdot(change, change) >= near**2:
            return False
    return True


def _crossing(sensor: Array, ray: Array, middle: Array, half: Array) -> tuple[Array, Array]:
    """(M,) where rays (M, 3) from a sensor enter and leave a cuboid, in lengths of the rays."""
    safe = np.where(np.abs(ray) > 1e-9, ray, 1e-9)
    one, other = (middle - half - sensor) / safe, (middle + half - sensor) / safe
    return np.minimum(one, other).max(axis=1), np.maximum(one, other).min(axis=1)
