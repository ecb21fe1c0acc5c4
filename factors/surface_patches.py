"""Surface of a vehicle as planar patches that move linearly with lambda, and the patch nearest to a point.

Every triangle of the mesh is a patch: its centre moves with lambda, its normal is the mean shape's. Which one is next
to a point is looked up in a grid over the mean shape, to which points are brought by the vehicle's size, and then among
the neighbours of that patch, at their places by lambda.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from factors.arrays import Array

SPACING = 0.12
"""Metres between the grid's points."""

MARGIN = 0.6
"""Metres around the mean shape that the grid reaches: a point beyond is at its border."""

NEIGHBOURS = 12
"""Patches that are looked at beside the one that is found in the grid, itself among them."""

_AT_ONCE = 2048  # grid points whose distances to all patches are in memory


@dataclass(frozen=True, eq=False)
class SurfacePatches:
    """Patches of a surface in the object frame."""

    mean: Array  # (P, 3) centres of the mean shape, metres
    basis: Array  # (N, P, 3) their change per unit of each coefficient
    normal: Array  # (P, 3) unit normals, outwards
    neighbours: NDArray[np.int32]  # (P, M) each patch and those nearest to it
    first: Array  # (3,) the grid's first point, metres
    grid: NDArray[np.int32]  # (X, Y, Z) the patch that is next to each of its points

    @classmethod
    def of(cls, vertices: Array, basis: Array, faces: NDArray[np.integer]) -> SurfacePatches:
        """The patches of a mesh: vertices (V, 3), their basis (N, V, 3), triangles (F, 3) that wind outwards or not."""
        corners = vertices[faces]
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        centres = corners.mean(axis=1)
        middle = (vertices.min(axis=0) + vertices.max(axis=0)) / 2.0
        if ((centres - middle) * normal).sum() < 0.0:
            normal = -normal
        length = np.linalg.norm(normal, axis=1)
        kept = length > 1e-9  # twice the area of a triangle that has one
        kept = np.flatnonzero(kept)[_near_one_another(centres[kept])]
        mean, normal = centres[kept], normal[kept] / length[kept, None]
        first = mean.min(axis=0) - MARGIN
        counts = np.ceil((mean.max(axis=0) + MARGIN - first) / SPACING).astype(int) + 1
        places = np.stack(np.meshgrid(*(np.arange(n) for n in counts), indexing="ij"), axis=-1)
        grid = _nearest(places.reshape(-1, 3) * SPACING + first, mean, 1)[:, 0].reshape(counts)
        neighbours = _nearest(mean, mean, min(NEIGHBOURS, len(mean)))
        return cls(mean, basis[:, faces].mean(axis=2)[:, kept], normal, neighbours, first, grid)

    @cached_property
    def packed(self) -> tuple[Any, ...]:
        """Arguments of the compiled rows: patches (P, 8), vectors, these along the normals, neighbours, grid."""
        vectors = np.ascontiguousarray(self.basis.transpose(1, 0, 2))
        along = np.ascontiguousarray((vectors * self.normal[:, None]).sum(axis=-1))
        nothing = np.zeros((len(self.mean), 1))
        patches = [self.mean, self.normal, (self.mean * self.normal).sum(axis=1, keepdims=True), nothing]
        return (
            np.concatenate(patches, axis=1),
            vectors.reshape(len(self.mean), -1),
            along,
            np.ascontiguousarray(self.neighbours),
            self.first,
            np.ascontiguousarray(self.grid),
        )

    def looked_up(self, points: Array) -> NDArray[np.int32]:
        """(Q,) the patch of the mean shape next to each point (Q, 3), roughly."""
        place = np.rint((points - self.first) / SPACING)
        x, y, z = np.clip(place, 0, np.array(self.grid.shape) - 1).astype(np.intp).T
        return self.grid[x, y, z]


def _near_one_another(centres: Array) -> NDArray[np.intp]:
    """(P,) an order of places (P, 3) in which neighbours are near one another: in memory as well."""
    cells = ((centres - centres.min(axis=0)) / SPACING).astype(np.uint64)
    code = np.zeros(len(centres), dtype=np.uint64)  # Morton's: the bits of the three, interleaved
    for bit in range(10):
        for axis in range(3):
            code |= ((cells[:, axis] >> np.uint64(bit)) & np.uint64(1)) << np.uint64(3 * bit + axis)
    return np.argsort(code, kind="stable")


def _nearest(points: Array, centres: Array, count: int) -> NDArray[np.int32]:
    """(Q, count) indices of the centres (P, 3) that are nearest to each point (Q, 3)."""
    squares = np.square(centres).sum(axis=1)
    found = np.empty((len(points), count), dtype=np.int32)
    for start in range(0, len(points), _AT_ONCE):
        some = slice(start, start + _AT_ONCE)
        away = squares - 2.0 * points[some] @ centres.T
        if count == 1:
            found[some, 0] = away.argmin(axis=1)
        else:
            found[some] = np.argpartition(away, count - 1, axis=1)[:, :count]
    return found
