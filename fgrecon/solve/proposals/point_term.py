"""Measured points as an energy term of the search: those about a vehicle's keypoints and box, and no more.

Taken are points on rays through the vehicle's 2D box, somewhat enlarged, at depths at which some vehicle fills it. That
is generous on purpose: which of them are the vehicle's is decided by the energy (`factors.surface_points`).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from factors.surface_patches import SurfacePatches
from factors.surface_points import PointRows, Shared
from fgrecon.core.arrays import Array
from fgrecon.core.camera import MIN_DEPTH, Camera
from fgrecon.core.depth_map import DepthMap, pixel_rays
from fgrecon.core.evidence import Evidence, Points
from fgrecon.core.observation import Observation
from fgrecon.core.shape_prior import ShapePrior
from fgrecon.solve.proposals.scaled_depth import ScaledDepth, scaled_depth
from fgrecon.solve.proposals.search_settings import SETTINGS
from fgrecon.solve.proposals.terms import Hypotheses, Quadratic
from fgrecon.solve.proposals.unsure_place import UnsurePlace
from fgrecon.solve.vehicle.model import VehicleModel

POINTS = SETTINGS.points


POINTS_NAME, DEPTH_NAME = "points", "depth"
"""Names of the terms, by what measured their points."""


_CELLS = 2**21
"""More than there are cells along an axis."""


@dataclass(frozen=True)
class PointTerm:
    """Points on the vehicle's surface, or on anything else."""

    rows: PointRows  # the points about the vehicle
    name: str = POINTS_NAME  # what measured them
    # the depth map, or the sensor's place, by which they are wrong together; None where they share nothing
    shared: ScaledDepth | UnsurePlace | None = None

    def add(self, total: Quadratic, h: Hypotheses) -> None:
        """Add this term."""
        rows, root = self.rows, self.rows.share**0.5
        size = 6 + h.coefficients.shape[1]
        residual, jacobian = np.zeros((len(h), len(rows.points))), np.zeros((len(h), len(rows.points), size))
        for i in range(len(h)):
            state = h.rotation[i], h.translation[i], h.coefficients[i]
            match = rows.match(*state)
            off, by = rows.distances(match, *state, want=True)
            assert by is not None
            weights, energy = rows.assess(match, off)
            scale = root * np.sqrt(weights)
            total.energy[i] += energy
            residual[i], jacobian[i] = scale * off, scale[:, None] * by[:, :size]  # what they share stays
        jacobian[..., 3:6] = jacobian[..., 3:6] @ h.rotation.transpose(0, 2, 1)
        total.add(residual, jacobian)

    def energies(self, h: Hypotheses) -> Array:
        """(H,) energies of the hypotheses, nats."""
        found = np.zeros(len(h))
        for i in range(len(h)):
            state = h.rotation[i], h.translation[i], h.coefficients[i]
            match = self.rows.match(*state)
            found[i] = self.rows.assess(match, self.rows.distances(match, *state, want=False)[0])[1]
        return found


def point_terms(observation: Observation, camera: Camera, model: VehicleModel) -> tuple[PointTerm, ...]:
    """The points of an observation's evidence about its vehicle, and the pixels of each of its depth maps.

    None of what has too few.
    """
    prior, box = model.prior, observation.place
    if prior.surface is None or box is None:
        return ()
    found: list[PointTerm] = []
    every = [one for one in observation.evidence if isinstance(one, Points)]
    for place in dict.fromkeys(map(UnsurePlace.of, every)):
        given = [one for one in every if UnsurePlace.of(one) == place]
        points, sigma, origin = [], [], np.asarray(given[0].origin, dtype=np.float64)
        for one in given:
            index = _about(one, box, camera)
            points.append(one.points[index])
            sigma.append(np.broadcast_to(np.asarray(one.sigma), (len(one.points),))[index])
        kept, noise = np.concatenate(points), np.concatenate(sigma)
        if len(kept) > POINTS.most_points:
            index = np.linspace(0, len(kept) - 1, POINTS.most_points).astype(np.intp)
            kept, noise = kept[index], noise[index]
        found.append(PointTerm(_rows(kept, noise, np.zeros(len(kept)), origin, model), POINTS_NAME, place))
    for depth in observation.evidence:
        if isinstance(depth, DepthMap):
            scaled = scaled_depth(depth)
            pixels, along = _pixels(scaled, box, camera)
            across = np.maximum(pixels[:, 2], 0.0) * (POINTS.pixel_sigma / camera.matrix[1, 1])
            rows = _rows(pixels, across, along, np.zeros(3), model, scaled.shared)
            found.append(PointTerm(rows, DEPTH_NAME, scaled if scaled.shared else None))
    return tuple(one for one in found if len(one.rows.points) >= POINTS.least_points)


def _rows(
    points: Array, sigma: Array, along: Array, origin: Array, model: VehicleModel, shared: Shared = Shared.NONE
) -> PointRows:
    """Points (M, 3) on a vehicle's surface, with standard deviations all round and along their rays (M,)."""
    independent = POINTS.independent_depths if along.any() else POINTS.independent_points
    return PointRows(
        points,
        np.hypot(sigma, POINTS.surface_sigma_m),
        origin,
        patches_of(model.prior),
        model.dimension_mean,
        model.dimension_basis,
        POINTS.odds,
        independent / (independent + len(points)),
        along,
        shared,
    )


def _pixels(depth: ScaledDepth, box: Array, camera: Camera) -> tuple[Array, Array]:
    """(M, 3) pixels of a depth map about where a vehicle must be, camera frame, and their deviations along the rays."""
    rows, columns = _window(depth.given, box)
    none = np.zeros((0, 3)), np.zeros(0)
    height, width = rows.stop - rows.start, columns.stop - columns.start
    if min(height, width) < 2:
        return none
    top, left = rows.start - depth.given.corner[0], columns.start - depth.given.corner[1]
    row, column = np.nonzero(np.isfinite(depth.given.depth[top : top + height, left : left + width]))
    step = max(1, int(np.ceil(np.sqrt((height - 1) * (width - 1) / POINTS.most_pixels))))
    _, first = np.unique((row // step) * width + column // step, return_index=True)
    row, column = row[first] + rows.start, column[first] + columns.start
    metres = depth.metres(row, column)
    nearest, farthest = _depths(box, float(camera.matrix[1, 1]), camera.image_size)
    along = depth.given.along(row, column, metres, depth.calibration.scale)
    kept = (metres + 2.0 * along > max(nearest, MIN_DEPTH)) & (metres - 2.0 * along < farthest) & (metres > MIN_DEPTH)
    if not kept.any():
        return none
    rays = pixel_rays(row[kept], column[kept], camera)
    far = np.isfinite(rays).all(axis=1)
    points, along = rays * metres[kept, None], along[kept] * np.linalg.norm(rays, axis=1)
    return points[far], along[far]


def _window(depth: DepthMap, box: Array) -> tuple[slice, slice]:
    """The rows and columns of the image, of those that a map has, in which a vehicle in a 2D box must be."""
    first = np.array(depth.corner[::-1])
    margin, last = POINTS.frustum_margin * (box[2:] - box[:2]).max(), first + depth.depth.shape[::-1]
    low = np.clip(np.ceil(box[:2] - margin), first, last).astype(int)
    high = np.clip(np.floor(box[2:] + margin) + 1.0, low, last).astype(int)
    return slice(int(low[1]), int(high[1])), slice(int(low[0]), int(high[0]))


@lru_cache(maxsize=16)
def patches_of(prior: ShapePrior) -> SurfacePatches:
    """The patches of a prior's surface, made once."""
    assert prior.surface is not None
    return SurfacePatches.of(prior.surface.mean, prior.surface.basis, prior.surface.faces)


def with_its_points(observation: Observation, camera: Camera) -> Observation:
    """The observation with those points and pixels alone that its vehicle uses: all of each frame is much to keep."""
    box, some = observation.place, list[Evidence]()
    for one in observation.evidence:
        if isinstance(one, Points):
            used = np.zeros(len(one.points), dtype=bool)
            used[() if box is None else _about(one, box, camera)] = box is not None
            some.append(one.chosen(used))
        elif isinstance(one, DepthMap) and box is not None:
            some.append(one.part(*_window(one, box)))
        else:
            some.append(one)
    return replace(observation, evidence=tuple(some)) if some else observation


def measured_by(observation: Observation, camera: Camera) -> Iterator[str]:
    """What measures how far an observation's vehicle is: terms of enough points, or of sure pixels, about it."""
    box, every = observation.place, observation.evidence
    if box is None:
        return
    if sum(len(_about(one, box, camera)) for one in every if isinstance(one, Points)) >= POINTS.least_points:
        yield POINTS_NAME
    for one in every:
        if isinstance(one, DepthMap) and one.known is not None and _is_sure(scaled_depth(one), box, camera):
            yield DEPTH_NAME


def _is_sure(depth: ScaledDepth, box: Array, camera: Camera) -> bool:
    """Whether a map's pixels about a vehicle, which share no error, are sure of their depths."""
    if depth.shared:
        return False
    pixels, along = _pixels(depth, box, camera)
    share = along / np.linalg.norm(pixels, axis=1)
    return len(pixels) >= POINTS.least_points and bool(np.median(share) < POINTS.sure_depth_share)


def _about(given: Points, box: Array, camera: Camera) -> NDArray[np.intp]:
    """Indices of the points about where the vehicle in a 2D box must be, thinned to one a cell."""
    return _chosen(given, tuple(box.tolist()), camera.matrix.tobytes(), camera.image_size)


@lru_cache(maxsize=16)  # whether there are any is asked before they are used
def _chosen(
    given: Points, box: tuple[float, ...], intrinsics: bytes, image_size: tuple[int, int] | None
) -> NDArray[np.intp]:
    """The same by what can be remembered."""
    left, top, right, bottom = box
    margin = POINTS.frustum_margin * max(right - left, bottom - top)
    focal = float(np.frombuffer(intrinsics)[4])
    nearest, farthest = _depths(np.array(box), focal, image_size)
    column, row, depth, cell = _placed(given, intrinsics)
    index = np.flatnonzero((column > left - margin) & (column < right + margin) & (depth < farthest))
    index = index[(row[index] > top - margin) & (row[index] < bottom + margin)]
    index = index[depth[index] > max(nearest, MIN_DEPTH)]
    _, first = np.unique(cell[index], return_index=True)
    return index[np.sort(first)]


@lru_cache(maxsize=4)  # all vehicles of an image ask for the same
def _placed(given: Points, intrinsics: bytes) -> tuple[Array, Array, Array, NDArray[np.int64]]:
    """(N,) columns and rows of the pixels, depths, and the cells that points are in, as one number."""
    points = given.points
    homogeneous = points @ np.frombuffer(intrinsics).reshape(3, 3).T
    depth = np.where(points[:, 2] > MIN_DEPTH, points[:, 2], np.nan)  # nan is in no box
    column, row = homogeneous[:, 0] / depth, homogeneous[:, 1] / depth
    cells = np.floor(points / POINTS.cell_m).astype(np.int64)
    return column, row, depth, (cells[:, 0] * _CELLS + cells[:, 1]) * _CELLS + cells[:, 2]


def _depths(box: Array, focal: float, image_size: tuple[int, int] | None) -> tuple[float, float]:
    """The nearest and the farthest depth at which some vehicle fills a 2D box, metres."""
    nearest, farthest = (focal * metres / float(box[3] - box[1]) for metres in POINTS.heights_m)
    if image_size is not None and (
        box[1] <= SETTINGS.border_pixels or box[3] >= image_size[1] - 1.0 - SETTINGS.border_pixels
    ):
        nearest = 0.0  # the image shows a part of its height
    return nearest, farthest
