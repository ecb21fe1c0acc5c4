"""Road plane by measured points: through the lowest point of each cell, as sure as roads are planes.

Points of a scan or of a depth map in metres ---- the lowest in each cell of the ground ---- robust plane ---- `Ground`

It takes the place of a ground that is given less surely, or of none. Where points do not show enough of a plane, or one
that the given ground excludes, nothing changes.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace
from typing import TypeGuard
from weakref import WeakKeyDictionary

import numpy as np

from fgrecon.core.arrays import Array
from fgrecon.core.camera import Camera, Ground
from fgrecon.core.choices import DepthScale
from fgrecon.core.depth_map import DepthCalibration, DepthMap, pixel_rays
from fgrecon.core.evidence import Evidence, Points
from fgrecon.solve.solve_settings import ROAD

# Vehicle by vehicle asks for the same scan's: its lowest points, and its plane with the ground that was given.
_cells: WeakKeyDictionary[Points | DepthMap, Array] = WeakKeyDictionary()
_planes: WeakKeyDictionary[Points | DepthMap, tuple[Ground | None, Ground | None]] = WeakKeyDictionary()


def ground_by_points(
    evidence: Sequence[Evidence], given: Ground | None, camera: Camera, disabled: Collection[str]
) -> Ground | None:
    """The ground that is given, or the plane of the measured points where that says it more surely.

    Args:
        evidence: Of an image.
        given: What is given of its ground, or None.
        camera: The camera, which tells where a depth map's pixels are.
        disabled: Kinds of evidence that do not count.
    """
    surer = given is not None and given.height_sigma <= ROAD.height_sigma and given.slope_sigma <= ROAD.slope_sigma
    if surer or camera.focal_sigma:
        return given
    plane = _plane_of([one for one in evidence if _metric(one, disabled)], given, camera)
    if plane is None:
        return given
    places = np.array([one.place_sigma for one in evidence if isinstance(one, Points)]).reshape(-1, 2)
    turn, shift = places.max(axis=0, initial=0.0)
    unsure = replace(
        plane,
        slope_sigma=float(np.hypot(plane.slope_sigma, turn)),
        height_sigma=float(np.hypot(plane.height_sigma, shift)),
    )
    if given is None:
        return unsure
    surer = unsure.height_sigma <= given.height_sigma and unsure.slope_sigma <= given.slope_sigma
    return replace(unsure, tilt_sigma=min(given.tilt_sigma, plane.tilt_sigma)) if surer else given


def _plane_of(evidence: Sequence[Points | DepthMap], given: Ground | None, camera: Camera) -> Ground | None:
    """The plane by the lowest points of all; None where too few show it. That of a single one is remembered."""
    only = evidence[0] if len(evidence) == 1 else None
    known = None if only is None else _planes.get(only)
    if known is not None and known[0] is given:
        return known[1]
    cells = np.concatenate([np.zeros((0, 3)), *(_lowest(one, camera) for one in evidence)])
    plane = _plane(cells, given) if len(cells) >= ROAD.least_cells else None
    if only is not None:
        _planes[only] = given, plane
    return plane


def _metric(one: Evidence, disabled: Collection[str]) -> TypeGuard[Points | DepthMap]:
    """Whether it has places in metres."""
    if isinstance(one, Points):
        return "points" not in disabled
    if not isinstance(one, DepthMap) or "depth" in disabled:
        return False
    return one.scale is DepthScale.METRIC and one.calibration is None  # else a scale that is unsure


def _lowest(one: Points | DepthMap, camera: Camera) -> Array:
    """(M, 3) the lowest of the points in each cell of the ground ahead, but for a few that may be wrong."""
    known = _cells.get(one)
    if known is None:
        points = one.points if isinstance(one, Points) else _pixels(one, camera)
        near, far = ROAD.depth_m
        points = points[(points[:, 2] > near) & (points[:, 2] < far) & (np.abs(points[:, 0]) < ROAD.side_m)]
        column, row = np.floor(points[:, [0, 2]] / ROAD.cell_m).astype(np.int64).T
        order = np.lexsort((points[:, 1], column, row))
        points, cell = points[order], (row * 4096 + column)[order]
        start = np.flatnonzero(np.diff(cell, prepend=-1))
        count = np.diff([*start, len(cell)])
        known = points[start + np.floor(ROAD.lowest_share * (count - 1)).astype(np.int64)]
        _cells[one] = known
    return known


def _pixels(depth: DepthMap, camera: Camera) -> Array:
    """(M, 3) some of a depth map's pixels as points; of a sparse one more than of one that has a depth everywhere."""
    step = max(1, int(np.sqrt(np.isfinite(depth.depth).sum() / ROAD.pixels)))
    row, column = (each.ravel() for each in np.mgrid[: depth.depth.shape[0] : step, : depth.depth.shape[1] : step])
    metres = depth.metres(depth.depth[row, column], DepthCalibration())
    kept = np.isfinite(metres)
    return np.asarray(pixel_rays(row[kept], column[kept], camera) * metres[kept, None])


def _plane(cells: Array, given: Ground | None) -> Ground | None:
    """The plane on which most of the lowest points (M, 3) are; None where too few show it, or `given` excludes it."""
    x, y, z = cells.T
    ahead = np.stack([np.ones(len(cells)), x, z], axis=1)  # y = a + b x + c z
    if given is None:
        nearer = z < np.median(z)
        if not nearer.any():  # a wall, all at one depth
            return None
        start = np.array([np.percentile(y[nearer], ROAD.start_percentile), 0.0, 0.0])
    else:
        start = np.array([given.distance, -given.normal[0], -given.normal[2]]) / given.normal[1]
    for scale in ROAD.scales_m:
        start = _robust(ahead, y, start, scale)
    off = ahead @ start - y
    on = np.abs(off) < ROAD.inlier_m
    spread = np.ptp(np.percentile(cells[on][:, [0, 2]], [5, 95], axis=0), axis=0) if on.any() else np.zeros(2)
    if on.sum() < ROAD.least_cells or on.mean() < ROAD.least_share or (spread < ROAD.least_spread_m).any():
        return None
    normal = np.array([-start[1], 1.0, -start[2]]) / np.linalg.norm([start[1], 1.0, start[2]])
    if start[0] <= 0.0 or (given is not None and _excluded(normal, start[0] * normal[1], given)):
        return None
    variance = np.square(off[on]).mean() * ROAD.correlated_cells
    about = ahead[on] - [0.0, 0.0, ROAD.typical_m]
    sigma = np.sqrt(variance * np.diag(np.linalg.inv(about.T @ about)))
    height, slope = np.hypot(ROAD.height_sigma, sigma[0]), np.hypot(ROAD.slope_sigma, max(sigma[1:]))
    return Ground(normal, float(start[0] * normal[1]), float(height), float(slope))


def _robust(design: Array, heights: Array, start: Array, scale: float) -> Array:
    """(3,) coefficients of the design (M, 3) whose Cauchy loss of heights (M,) is a minimum, by reweighing."""
    found = start
    for _ in range(ROAD.reweighings):
        weighed = design.T / (1.0 + np.square((design @ found - heights) / scale))
        before, found = found, np.asarray(np.linalg.solve(weighed @ design, weighed @ heights), dtype=np.float64)
        if np.abs(found - before).max() < ROAD.converged:
            break
    return found


def _excluded(normal: Array, distance: float, given: Ground) -> bool:
    """Whether a plane is none that the given ground allows."""
    off = np.array([distance - given.distance, *(normal - given.normal)[[0, 2]]])
    sigma = np.array([given.height_sigma, given.slope_sigma, given.slope_sigma])
    return bool((np.abs(off) > ROAD.excluded_sigmas * sigma).any())
