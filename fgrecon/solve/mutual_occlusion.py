"""What the nearer vehicles of an image hide of the others.

It is in the results and is no evidence: a network that has learnt from traffic places hidden keypoints about as
well as it says, and without them poses were no better (docs/history/size.md).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.arrays import Array
from fgrecon.core.camera import MIN_DEPTH
from fgrecon.core.geometry import transform
from fgrecon.core.reconstruction import Reconstruction
from fgrecon.solve.vehicle.visibility import clearance, probability

_UNHIDDEN = probability(np.zeros(1))  # of what nothing hides, which stays as visible as it is


def with_occlusion(results: Sequence[Reconstruction]) -> tuple[Reconstruction, ...]:
    """The vehicles of one image, whose keypoints are as visible as the nearer of them leave them."""
    if len(results) < 2:
        return tuple(results)
    points = [transform(one.camera_T_object, one.wireframe) for one in results]
    pixels = [_projected(one) for one in points]
    visibilities = [one.diagnostics.visibility for one in results]
    for there, other in enumerate(results):
        front = _placed(other)
        if front is None or other.shape.surface_faces is None:
            continue
        vertices, (low, high) = front
        covered: dict[int, NDArray[np.intp]] = {}  # keypoints of further vehicles inside the rectangle around it
        for here, one in enumerate(results):
            at = pixels[here]
            if here != there and at is not None and other.location[2] < one.location[2]:
                inside = np.flatnonzero(((at >= low) & (at <= high)).all(axis=1))
                covered |= {here: inside} if len(inside) else {}
        if not covered:
            continue
        rays = np.concatenate([points[here][inside] for here, inside in covered.items()])
        left = probability(clearance(vertices, other.shape.surface_faces, rays, np.zeros(3))) / _UNHIDDEN
        ends = np.cumsum([len(inside) for inside in covered.values()])[:-1]
        for (here, inside), share in zip(covered.items(), np.split(left, ends), strict=True):
            visibilities[here] = visibilities[here].copy()
            visibilities[here][inside] *= share
    return tuple(
        one if now is one.diagnostics.visibility else replace(one, diagnostics=replace(one.diagnostics, visibility=now))
        for one, now in zip(results, visibilities, strict=True)
    )


def _placed(result: Reconstruction) -> tuple[Array, tuple[Array, Array]] | None:
    """(V, 3) surface in the camera's frame, and the corners (2,) of the rectangle around its image.

    None where there is none, or it is not wholly in front of the camera.
    """
    if result.shape.surface_vertices is None or not np.isfinite(result.camera_T_object).all():
        return None
    vertices = transform(result.camera_T_object, result.shape.surface_vertices)
    if not vertices[:, 2].min() > MIN_DEPTH:
        return None
    around = vertices[:, :2] / vertices[:, 2:]
    return vertices, (around.min(axis=0), around.max(axis=0))


def _projected(points: Array) -> Array | None:
    """(K, 2) where points (K, 3) are seen at a focal length of 1; None where they are not all before the camera."""
    if not (np.isfinite(points).all() and points[:, 2].min() > 0.0):
        return None
    return points[:, :2] / points[:, 2:]
