"""What the nearer vehicles of an image hide of the others.

It is told in the results and is no evidence: a network that has learnt from traffic places hidden keypoints about as
well as it says, and without them poses were no better (docs/history.md).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.camera import MIN_DEPTH
from fgrecon.core.reconstruction import Reconstruction
from fgrecon.solve.vehicle.visibility import clearance, probability

__all__ = ["with_occlusion"]

Array = NDArray[np.float64]


def with_occlusion(results: Sequence[Reconstruction]) -> tuple[Reconstruction, ...]:
    """The vehicles of one image, whose keypoints are as visible as the nearer of them leave them."""
    placed = [_placed(result) for result in results]
    told = []
    for here, result in enumerate(results):
        points = result.wireframe @ result.camera_T_object[:3, :3].T + result.camera_T_object[:3, 3]
        seen = result.visibility
        for there, (other, vertices) in enumerate(zip(results, placed, strict=True)):
            if there == here or vertices is None or not other.location[2] < result.location[2]:
                continue
            if not _overlap(points, vertices):
                continue
            assert other.surface_faces is not None
            seen = seen * probability(clearance(vertices, other.surface_faces, points, np.zeros(3)))
        told.append(result if seen is result.visibility else replace(result, visibility=seen))
    return tuple(told)


def _placed(result: Reconstruction) -> Array | None:
    """(V, 3) surface in the camera's frame; None where there is none, or not wholly in front of the camera."""
    if result.surface_vertices is None or not np.isfinite(result.camera_T_object).all():
        return None
    vertices: Array = result.surface_vertices @ result.camera_T_object[:3, :3].T + result.camera_T_object[:3, 3]
    return vertices if vertices[:, 2].min() > MIN_DEPTH else None


def _overlap(points: Array, vertices: Array) -> bool:
    """Whether a surface (V, 3) may cover some of points (K, 3), by the rectangle around its image."""
    if not (np.isfinite(points).all() and points[:, 2].min() > 0.0):
        return False
    seen, around = points[:, :2] / points[:, 2:], vertices[:, :2] / vertices[:, 2:]
    inside = (seen >= around.min(axis=0)) & (seen <= around.max(axis=0))
    return bool(inside.all(axis=1).any())
