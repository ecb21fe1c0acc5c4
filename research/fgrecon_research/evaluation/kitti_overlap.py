"""Overlaps of KITTI's boxes: in the image, from above, and in 3D."""

from __future__ import annotations

from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from fgrecon.calibration.matching import box_overlap, shared_ratio
from fgrecon.io.kitti_files import Objects

Array = NDArray[np.float64]


class Space(StrEnum):
    """Where overlaps are measured."""

    IMAGE = "image"
    GROUND = "ground"
    """Bird's eye view: the boxes' footprints."""
    VOLUME = "3d"


def overlap(space: Space, first: Objects, second: Objects, *, of_first: bool = False) -> Array:
    """Overlap (M, N) of every object with every other.

    Args:
        space: Where.
        first: M objects.
        second: N objects.
        of_first: Divide the intersection by the first object's own extent instead of the union.
    """
    if space is Space.IMAGE:
        return box_overlap(first.box, second.box, of_first=of_first)
    extent_first, extent_second = (objects.size[:, 0] * objects.size[:, 1] for objects in (first, second))
    inner = _footprint_intersection(first, second)
    if space is Space.VOLUME:
        top = np.maximum((first.location[:, 1] - first.size[:, 2])[:, None], second.location[:, 1] - second.size[:, 2])
        bottom = np.minimum(first.location[:, None, 1], second.location[:, 1])
        inner = inner * np.maximum(bottom - top, 0.0)
        extent_first, extent_second = extent_first * first.size[:, 2], extent_second * second.size[:, 2]
    return shared_ratio(inner, extent_first, extent_second, of_first=of_first)


def _footprint_intersection(first: Objects, second: Objects) -> Array:
    """Areas (M, N) that footprints share; zero without calculation where their circumcircles do not meet."""
    area = np.zeros((len(first), len(second)))
    reach = [0.5 * np.hypot(objects.size[:, 0], objects.size[:, 1]) for objects in (first, second)]
    offset = first.location[:, None, [0, 2]] - second.location[:, [0, 2]]
    solid = np.all(first.size > 0, axis=1)[:, None] & np.all(second.size > 0, axis=1)[None]
    near = solid & (np.hypot(offset[..., 0], offset[..., 1]) < reach[0][:, None] + reach[1])
    corners = [_footprints(objects) for objects in (first, second)]
    for i, j in np.argwhere(near):
        area[i, j] = convex_intersection_area(corners[0][i], corners[1][j])
    return area


def _footprints(objects: Objects) -> Array:
    """(M, 4, 2) corners (x, z) of the footprints, in one sense of rotation."""
    cosine, sine = np.cos(objects.rotation_y), np.sin(objects.rotation_y)
    along = np.stack([cosine, -sine], axis=1) * objects.size[:, :1] / 2.0
    across = np.stack([sine, cosine], axis=1) * objects.size[:, 1:2] / 2.0
    corners = np.stack([along + across, along - across, -along - across, -along + across], axis=1)
    placed: Array = corners + objects.location[:, None, [0, 2]]
    return placed


def convex_intersection_area(subject: Array, clip: Array) -> float:
    """Area that two convex polygons (P, 2) and (Q, 2) share (Sutherland and Hodgman); any sense of rotation."""
    points = [(float(x), float(y)) for x, y in subject]
    edges = [(float(x), float(y)) for x, y in clip]
    sense = 1.0 if _signed_area(edges) > 0 else -1.0
    for (ax, ay), (bx, by) in zip(edges, edges[1:] + edges[:1], strict=True):
        side = [sense * ((bx - ax) * (y - ay) - (by - ay) * (x - ax)) for x, y in points]
        kept: list[tuple[float, float]] = []
        for k, ((px, py), s) in enumerate(zip(points, side, strict=True)):
            (qx, qy), t = points[k - 1], side[k - 1]
            if (s >= 0) != (t >= 0):
                share = t / (t - s)
                kept.append((qx + share * (px - qx), qy + share * (py - qy)))
            if s >= 0:
                kept.append((px, py))
        points = kept
        if not points:
            return 0.0
    return abs(_signed_area(points))


def _signed_area(points: list[tuple[float, float]]) -> float:
    pairs = zip(points, points[1:] + points[:1], strict=True)
    return 0.5 * sum(ax * by - bx * ay for (ax, ay), (bx, by) in pairs)
