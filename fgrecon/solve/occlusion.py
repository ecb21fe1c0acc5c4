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

_UNHIDDEN = probability(np.zeros(1))  # of what nothing hides, which stays as visible as it is


def with_occlusion(results: Sequence[Reconstruction]) -> tuple[Reconstruction, ...]:
    """The vehicles of one image, whose keypoints are as visible as the nearer of them leave them."""
    if len(results) < 2:
        return tuple(results)
    placed = [_placed(result) for result in results]
    told = []
    for here, result in enumerate(results):
        points = result.wireframe @ result.camera_T_object[:3, :3].T + result.camera_T_object[:3, 3]
        pixels, depth, seen = _projected(points), result.location[2], result.visibility
        for there, (other, front) in enumerate(zip(results, placed, strict=True)):
            if there == here or front is None or pixels is None or not other.location[2] < depth:
                continue
            vertices, (low, high) = front
            covered = np.flatnonzero(((pixels >= low) & (pixels <= high)).all(axis=1))  # by the rectangle around it
            if not len(covered):
                continue
            assert other.surface_faces is not None
            behind = clearance(vertices, other.surface_faces, points[covered], np.zeros(3))
            seen = seen.copy()
            seen[covered] *= probability(behind) / _UNHIDDEN
        told.append(result if seen is result.visibility else replace(result, visibility=seen))
    return tuple(told)


def _placed(result: Reconstruction) -> tuple[Array, tuple[Array, Array]] | None:
    """(V, 3) surface in the camera's frame, and the corners (2,) of the rectangle around its image.

    None where there is none, or it is not wholly in front of the camera.
    """
    if result.surface_vertices is None or not np.isfinite(result.camera_T_object).all():
        return None
    vertices: Array = result.surface_vertices @ result.camera_T_object[:3, :3].T + result.camera_T_object[:3, 3]
    if not vertices[:, 2].min() > MIN_DEPTH:
        return None
    around = vertices[:, :2] / vertices[:, 2:]
    return vertices, (around.min(axis=0), around.max(axis=0))


def _projected(points: Array) -> Array | None:
    """(K, 2) where points (K, 3) are seen at a focal length of 1; None where they are not all before the camera."""
    if not (np.isfinite(points).all() and points[:, 2].min() > 0.0):
        return None
    seen: Array = points[:, :2] / points[:, 2:]
    return seen
