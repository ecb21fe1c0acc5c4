"""Occlusion of an image's vehicles by nearer ones.

It is in the results and is no evidence: a network that has learnt from traffic places hidden keypoints about as
well as it says, and without them poses were no better (docs/history/size.md).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.arrays import Array
from fgrecon.core.camera import MIN_DEPTH
from fgrecon.core.geometry import transform
from fgrecon.core.reconstruction import Reconstruction
from fgrecon.solve.vehicle.visibility import clearance, probability

_UNHIDDEN = probability(np.zeros(1))  # of what nothing hides, which stays as visible as it is


def with_occlusion(results: Sequence[Reconstruction]) -> tuple[Reconstruction, ...]:
    """The vehicles of one image, whose keypoints are as visible as the nearer of them leave them, when asked."""
    solids = [_Solid.of(one) for one in results]
    found = []
    for one in results:
        nearer = [solids[n] for n, other in enumerate(results) if other.location[2] < one.location[2]]
        if nearer:
            visibility = partial(_left, one.diagnostics.maker("visibility"), one.camera_T_object, one.wireframe, nearer)
            one = replace(one, diagnostics=one.diagnostics.but_later(visibility=visibility))
        found.append(one)
    return tuple(found)


@dataclass(frozen=True)
class _Solid:
    """What hides others."""

    camera_T_object: Array  # (4, 4)
    vertices: Callable[[], Array | None]  # make (V, 3) in the object frame
    faces: Callable[[], NDArray[np.int64] | None]  # make (F, 3)

    @classmethod
    def of(cls, result: Reconstruction) -> _Solid:
        """A vehicle."""
        shape = result.shape
        return cls(result.camera_T_object, shape.maker("surface_vertices"), shape.maker("surface_faces"))

    def placed(self) -> Array | None:
        """(V, 3) surface in the camera's frame; None where there is none, or it is not wholly before the camera."""
        vertices = self.vertices()
        if vertices is None or not np.isfinite(self.camera_T_object).all():
            return None
        there = transform(self.camera_T_object, vertices)
        return there if there[:, 2].min() > MIN_DEPTH else None


def _left(own: Callable[[], Array], camera_T_object: Array, wireframe: Array, nearer: Sequence[_Solid]) -> Array:
    """(K,) visibility of keypoints (K, 3) of a vehicle, which by itself has its `own`, behind nearer ones."""
    visibility, points = own(), transform(camera_T_object, wireframe)
    if not (np.isfinite(points).all() and points[:, 2].min() > 0.0):
        return visibility
    at = points[:, :2] / points[:, 2:]
    for one in nearer:
        vertices, faces = one.placed(), one.faces()
        if vertices is None or faces is None:
            continue
        around = vertices[:, :2] / vertices[:, 2:]
        inside = np.flatnonzero(((at >= around.min(axis=0)) & (at <= around.max(axis=0))).all(axis=1))
        if len(inside):
            visibility = visibility.copy()
            visibility[inside] *= probability(clearance(vertices, faces, points[inside], np.zeros(3))) / _UNHIDDEN
    return visibility
