"""A mesh topology that is exactly mirror-symmetric about z = 0, from one that is so only approximately.

The left half is cut off along z = 0 of the mean shape and its mirror image becomes the right half. The cut is made
once, in the topology: the same cut fits every shape, so linear models of the vertices stay linear.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.geometry import MIRROR

Array = NDArray[np.float64]


@dataclass(frozen=True)
class SymmetricMesh:
    """Shapes in one topology that is its own mirror image."""

    vertices: Array  # (M, V, 3) vertices of each shape; z = 0 on the seam
    faces: NDArray[np.int32]  # (F, 3) triangles, the first half on the left (z >= 0)
    mirror: NDArray[np.intp]  # (V,) index of each vertex's mirror image; its own index on the seam


def mirrored_half(vertices: Array, faces: NDArray[np.int32], seam_width: float = 0.01) -> SymmetricMesh:
    """Cut shapes (M, V, 3) of one topology (F, 3) along z = 0 of their mean and mirror the left half.

    Args:
        vertices: Vertices of each shape, nearly symmetric about z = 0, left is +z, metres.
        faces: Triangles.
        seam_width: Vertices whose mean is closer to z = 0 than this are moved onto it, which avoids slivers.
    """
    height = vertices.mean(axis=0)[:, 2]
    height = np.where(np.abs(height) < seam_width, 0.0, height)
    cuts: dict[tuple[int, int], int] = {}
    left = [part for face in faces for part in _clip(tuple(int(i) for i in face), height, cuts)]
    extended = np.concatenate([vertices, *(_cut_points(vertices, height, cuts))], axis=1)
    extended_height = np.concatenate([height, np.zeros(len(cuts))])
    used, index = np.unique(np.array(left), return_inverse=True)
    half = extended[:, used].copy()
    seam = extended_height[used] == 0.0
    half[:, seam, 2] = 0.0
    count = len(used)
    partner = np.arange(count)
    partner[~seam] = count + np.arange((~seam).sum())
    left_faces = index.reshape(-1, 3)
    right_faces = partner[left_faces][:, ::-1]  # the mirror image turns the other way round
    return SymmetricMesh(
        vertices=np.concatenate([half, half[:, ~seam] * MIRROR], axis=1),
        faces=np.concatenate([left_faces, right_faces]).astype(np.int32),
        mirror=np.concatenate([partner, np.flatnonzero(~seam)]),
    )


def _clip(face: tuple[int, ...], height: Array, cuts: dict[tuple[int, int], int]) -> list[tuple[int, int, int]]:
    """The part of a triangle with height >= 0, as 0 to 2 triangles; cut edges get new vertices, noted in `cuts`."""
    if (height[list(face)] > 0).sum() == 0:
        return []
    polygon: list[int] = []
    for a, b in zip(face, (*face[1:], face[0]), strict=True):
        if height[a] >= 0:
            polygon.append(a)
        if height[a] * height[b] < 0:
            edge = (min(a, b), max(a, b))
            polygon.append(cuts.setdefault(edge, len(height) + len(cuts)))
    return [(polygon[0], polygon[i], polygon[i + 1]) for i in range(1, len(polygon) - 1)]


def _cut_points(vertices: Array, height: Array, cuts: dict[tuple[int, int], int]) -> list[Array]:
    if not cuts:
        return []
    a, b = np.array(list(cuts)).T
    share = (height[a] / (height[a] - height[b]))[:, None]
    return [vertices[:, a] * (1 - share) + vertices[:, b] * share]
