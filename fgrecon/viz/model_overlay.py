"""Car models rendered as the camera would see them, to be laid over the photograph."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.camera import Camera
from fgrecon.core.geometry import transform
from fgrecon.core.vehicle_mesh import VehicleMesh
from fgrecon.viz.geometry import image_points
from fgrecon.viz.style import Colour

__all__ = ["PosedModel", "render_models"]

PosedModel = tuple[VehicleMesh, NDArray[np.float64], Colour]
"""A model, the pose (4, 4) it is seen at, and its colour."""

_LARGEST = 2000.0  # pixels of the rendering's longer side
_OPACITY, _DARKEST = 0.8, 0.5
_LIGHT = np.array([-0.3, -0.85, -0.45])  # in the camera frame: from above, and from the camera's left


def render_models(models: Sequence[PosedModel], camera: Camera, size: tuple[float, float]) -> NDArray[np.uint8]:
    """(h, w, 4) RGBA of shaded models, the nearest over the others; transparent elsewhere.

    Args:
        models: What is seen.
        camera: The camera.
        size: Width and height of its image, pixels; a larger one is rendered smaller.
    """
    import cv2

    scale = min(1.0, _LARGEST / max(size))
    canvas = np.zeros((max(round(size[1] * scale), 1), max(round(size[0] * scale), 1), 4), dtype=np.uint8)
    found = [_triangles(*item, camera) for item in models]
    if not found:
        return canvas
    pixels, depths, colours = (np.concatenate([item[part] for item in found]) for part in range(3))
    sharp = 3  # bits behind the point
    corners = np.rint((pixels + 0.5) * scale * 2**sharp - 2 ** (sharp - 1)).astype(np.int32)
    for index in np.argsort(-depths):  # the nearest last
        red, green, blue = (int(channel) for channel in colours[index])
        cv2.fillConvexPoly(canvas, corners[index], (red, green, blue, round(255 * _OPACITY)), shift=sharp)
    return canvas


def _triangles(
    model: VehicleMesh, pose: NDArray[np.float64], colour: Colour, camera: Camera
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Pixels (F, 3, 2), depths (F,) and colours (F, 3) of the triangles that can be drawn."""
    corners = transform(pose, model.vertices)[model.faces]
    pixels = image_points(camera, pose, model.vertices)[model.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    lengths = np.linalg.norm(normals, axis=1)
    normals = normals / np.where(lengths > 0, lengths, 1.0)[:, None]
    middles = corners.mean(axis=1)
    normals *= np.where((normals * middles).sum(axis=1) > 0, -1.0, 1.0)[:, None]  # towards the camera
    light = _DARKEST + (1.0 - _DARKEST) * np.clip(normals @ (_LIGHT / np.linalg.norm(_LIGHT)), 0.0, 1.0)
    lit = 255.0 - (255.0 - np.array(colour, dtype=np.float64)) * 0.75
    drawn = np.isfinite(pixels).all(axis=(1, 2)) & (np.abs(pixels) < 3e4).all(axis=(1, 2)) & (lengths > 0)
    return pixels[drawn], middles[drawn, 2], (light[:, None] * lit)[drawn]
