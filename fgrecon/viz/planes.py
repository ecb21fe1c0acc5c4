"""Planes of a wireframe as quads to draw: faces, and the medial plane, fitted to the keypoints of every step."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.geometry import cross

__all__ = ["face_outlines", "fan", "medial_outlines"]

Indices = tuple[int, ...]


def face_outlines(keypoints: NDArray[np.float64], faces: Mapping[str, Indices]) -> dict[str, NDArray[np.float64]]:
    """(n, F, 3) keypoints of every face, moved onto the plane that fits them best.

    Args:
        keypoints: (n, K, 3) keypoints of n steps.
        faces: F indices of each in order around the face, at least three.
    """
    outlines = dict.fromkeys(faces, keypoints)
    for corners in {len(face) for face in faces.values()}:  # all faces of as many corners at once
        chosen = {name: face for name, face in faces.items() if len(face) == corners}
        points = keypoints[:, list(chosen.values())]
        centred = points - points.mean(axis=2, keepdims=True)
        normals = np.linalg.svd(centred, full_matrices=False)[2][..., -1, :]
        flat = points - (centred @ normals[..., None]) * normals[..., None, :]
        outlines |= dict(zip(chosen, flat.swapaxes(0, 1), strict=True))
    return outlines


def medial_outlines(keypoints: NDArray[np.float64], pairs: NDArray[np.int64]) -> NDArray[np.float64]:
    """(n, 4, 3) corners of a rectangle in the plane halfway between mirrored keypoints, as large as the wireframe.

    Args:
        keypoints: (n, K, 3) keypoints of n steps, object frame.
        pairs: (P, 2) indices (left, right), at least one pair.
    """
    left, right = keypoints[:, pairs[:, 0]], keypoints[:, pairs[:, 1]]
    middle = ((left + right) / 2).mean(axis=1)
    normal = (left - right).sum(axis=1)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    forward = np.array([1.0, 0.0, 0.0]) - normal[:, :1] * normal
    forward /= np.linalg.norm(forward, axis=1, keepdims=True)
    axes = np.stack([forward, cross(normal, forward)], axis=1)
    extents = (keypoints - middle[:, None]) @ axes.transpose(0, 2, 1)
    low, high = extents.min(axis=1), extents.max(axis=1)
    corners = np.stack([low, np.stack([high[:, 0], low[:, 1]], 1), high, np.stack([low[:, 0], high[:, 1]], 1)], axis=1)
    outline: NDArray[np.float64] = middle[:, None] + corners @ axes
    return outline


def fan(corners: int) -> tuple[tuple[int, int, int], ...]:
    """Triangles of a convex polygon, seen from both sides."""
    front = [(0, i, i + 1) for i in range(1, corners - 1)]
    return (*front, *((c, b, a) for a, b, c in front))
