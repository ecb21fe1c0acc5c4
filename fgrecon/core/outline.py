"""What of an object in front of a camera is in its image: points beyond the near plane, their pixels, their extent."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.camera import MIN_DEPTH, Camera
from fgrecon.core.geometry import box_around

Array = NDArray[np.float64]

_UNDONE = 1.0  # pixels by which a lens that is undone may miss
_LEAST_SIDE = 1.0  # pixels: what is narrower in the image is not in it
_BOX_EDGES = np.array([(i, j) for i in range(8) for j in range(i + 1, 8) if (i ^ j) in (1, 2, 4)])


def points_ahead(points: Array, edges: NDArray[np.int64]) -> Array:
    """Those of the points (V, 3) in front of the camera, and where edges (E, 2) pass its near plane: (M, 3)."""
    ahead = points[:, 2] >= MIN_DEPTH
    if ahead.all():
        return points
    first, last = points[edges[ahead[edges].sum(axis=1) == 1]].swapaxes(0, 1)
    share = (MIN_DEPTH - first[:, 2:]) / (last[:, 2:] - first[:, 2:])
    return np.concatenate([points[ahead], first + share * (last - first)])


def imaged(camera: Camera, points: Array) -> Array:
    """(M, 2) pixels of points (M, 3); far outside of the image, where the lens cannot be undone, those of a pinhole."""
    ideal = camera.project(points)
    pixels = camera.distort(ideal)
    back, known = camera.ideal_pixels(pixels)
    right = known & (np.abs(back - ideal).max(axis=1) < _UNDONE)
    return np.where(right[:, None], pixels, ideal)


def box_outline(corners: Array, camera: Camera) -> tuple[Array, float] | None:
    """The 2D box (4,) of a 3D box, cut at the near plane and at the image's edges, and the share that was cut off.

    Args:
        corners: (8, 3) in the camera's frame, in the order of `fgrecon.core.box3d.box_corners`.
        camera: The camera, with the size of its image.

    Returns:
        The box and the share of its area outside the image; None where less than a pixel is in it.
    """
    assert camera.image_size is not None
    points = points_ahead(corners, _BOX_EDGES)
    if not len(points):
        return None
    whole = box_around(imaged(camera, points))
    cut = np.clip(whole, 0.0, np.tile(np.subtract(camera.image_size, 1.0), 2))
    if (cut[2:] - cut[:2]).min() < _LEAST_SIDE:
        return None
    return cut, float(1.0 - np.prod(cut[2:] - cut[:2]) / np.prod(whole[2:] - whole[:2]))
