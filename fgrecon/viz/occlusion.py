"""Occlusion of drawn triangles: car models laid over the photograph, and the hidden parts of lines."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.arrays import Array
from fgrecon.core.camera import Camera
from fgrecon.core.geometry import transform
from fgrecon.core.reconstruction import Reconstruction
from fgrecon.core.vehicle_mesh import Colour, VehicleMesh
from fgrecon.viz.geometry import fan, image_points

PosedModel = tuple[VehicleMesh, Array, Colour]
"""A model, the pose (4, 4) it has, and its colour."""

_LARGEST_DEPTH, _LARGEST_RENDERING = 1500.0, 2000.0  # pixels of the longer sides
_FARTHEST_PIXEL = 3e4  # that OpenCV draws
_SUBPIXEL_BITS = 3
_TOLERANCE = 0.4  # metres: lines between points of a surface run below it, as a roof bends over its edges' chords
_PIECES = 16
_SHORT = 4  # pieces of a run that are no run of their own: a mirror hides no edge, a gap shows none
_OPACITY = 0.8
_LIGHT = np.array([-0.3, -0.85, -0.45])  # in the camera frame: from above, and from the camera's left


def _triangles(
    camera: Camera, pose: Array, vertices: Array, faces: NDArray[np.int64]
) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Pixels (F, 3, 2), corners (F, 3, 3) in the camera frame, and (F,) whether they can be drawn."""
    pixels = image_points(camera, pose, vertices)[faces]
    drawn = np.isfinite(pixels).all(axis=(1, 2)) & (np.abs(pixels) < _FARTHEST_PIXEL).all(axis=(1, 2))
    return pixels, transform(pose, vertices)[faces], np.asarray(drawn)


def shading(corners: Array, light: Array, outward: Array) -> Array:
    """(F,) brightness from 0.5 to 1 of triangles (F, 3, 3), each turned to the side where `outward` (F, 3) points."""
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    normals = normals / np.where(lengths > 0, lengths, 1.0)
    normals *= np.where((normals * outward).sum(axis=1) < 0, -1.0, 1.0)[:, None]  # a mesh need not be oriented
    return 0.5 + 0.5 * np.clip(normals @ (light / np.linalg.norm(light)), 0.0, 1.0)


def render_models(models: Sequence[PosedModel], camera: Camera, size: tuple[float, float]) -> NDArray[np.uint8]:
    """(h, w, 4) RGBA of shaded car models, the nearest over the others; transparent elsewhere.

    An image of a size (width, height) in pixels that is larger than is needed is rendered smaller.
    """
    import cv2

    scale = min(1.0, _LARGEST_RENDERING / max(size))
    canvas = np.zeros((max(round(size[1] * scale), 1), max(round(size[0] * scale), 1), 4), dtype=np.uint8)
    shown = []
    for model, pose, colour in models:
        pixels, corners, drawn = _triangles(camera, pose, model.vertices, model.faces)
        middles = corners.mean(axis=1)
        drawn &= np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]).any(axis=1)
        lit = 255.0 - (255.0 - np.array(colour, dtype=np.float64)) * 0.75
        colours = shading(corners, _LIGHT, -middles)[:, None] * lit
        shown.append((pixels[drawn], middles[drawn, 2], colours[drawn]))
    if not shown:
        return canvas
    pixels, depths, colours = (np.concatenate(part) for part in zip(*shown, strict=True))
    corners = np.rint((pixels + 0.5) * scale * 2**_SUBPIXEL_BITS - 2 ** (_SUBPIXEL_BITS - 1)).astype(np.int32)
    for index in np.argsort(-depths):  # the nearest last
        red, green, blue = (int(channel) for channel in colours[index])
        rgba = (red, green, blue, round(255 * _OPACITY))
        cv2.fillConvexPoly(canvas, corners[index], rgba, shift=_SUBPIXEL_BITS)
    return canvas


@dataclass(frozen=True, eq=False)
class DepthImage:
    """How far away what covers each pixel is."""

    depth: NDArray[np.float32]  # (h, w) metres; infinite where nothing is
    scale: float  # its pixels in a pixel of the image

    def hides(self, pixels: Array, depths: Array) -> NDArray[np.bool_]:
        """(...) whether something is before points at pixels (..., 2) and depths (...) in metres."""
        height, width = self.depth.shape
        with np.errstate(invalid="ignore"):
            columns, rows = np.moveaxis(np.rint(np.nan_to_num(pixels, nan=-1.0) * self.scale).astype(np.int64), -1, 0)
            inside = (columns >= 0) & (columns < width) & (rows >= 0) & (rows < height)
            hidden = np.zeros(inside.shape, dtype=np.bool_)
            hidden[inside] = self.depth[rows[inside], columns[inside]] < depths[inside] - _TOLERANCE
        return hidden


def depth_image(results: Iterable[Reconstruction], camera: Camera, size: tuple[float, float]) -> DepthImage:
    """The depth image of vehicles with a pose, for an image of a size (width, height) in pixels.

    It is that of their surfaces, else of the faces of their wireframes.
    """
    import cv2

    scale = min(1.0, _LARGEST_DEPTH / max(size))
    depth = np.full((max(round(size[1] * scale), 1), max(round(size[0] * scale), 1)), np.inf, dtype=np.float32)
    triangles = [(np.zeros((0, 3, 2), np.int32), np.zeros(0))]
    for result in results:
        pixels, corners, drawn = _triangles(camera, result.camera_T_object, *_surface(result))
        drawn &= (np.abs(pixels * scale) < _FARTHEST_PIXEL).all(axis=(1, 2))
        triangles.append((np.rint(pixels[drawn] * scale).astype(np.int32), corners[drawn, :, 2].mean(axis=1)))
    outlines, far = (np.concatenate(part) for part in zip(*triangles, strict=True))
    for index in np.argsort(-far):  # the nearest last
        cv2.fillConvexPoly(depth, outlines[index], float(far[index]))
    return DepthImage(depth, scale)


def _surface(result: Reconstruction) -> tuple[Array, NDArray[np.int64]]:
    """Vertices (V, 3) and triangles (F, 3) that hide what is behind them."""
    if result.shape.surface_vertices is not None and result.shape.surface_faces is not None:
        return result.shape.surface_vertices, result.shape.surface_faces
    triangles = [[face[corner] for corner in part] for face in result.shape.faces.values() for part in fan(len(face))]
    return result.wireframe, np.array(triangles, dtype=np.int64).reshape(-1, 3)


def pieces_of(lines: Array, count: int = _PIECES) -> Array:
    """Lines (L, 2, 3) as (L, count + 1, 3) points along each, ends included."""
    along = np.linspace(0.0, 1.0, count + 1)[:, None]
    return lines[:, :1] * (1.0 - along) + lines[:, 1:] * along


def runs_of(points: Array, camera: Camera, depth: DepthImage | None) -> tuple[list[Array], list[Array]]:
    """What is visible of lines, and what is hidden, as paths in the image.

    Args:
        points: (L, P, 3) points along each, in the camera frame.
        depth: What stands in the way, or None.

    Returns:
        Paths (n, 2) in pixels, n from 2 to P, that are visible, and those that are hidden; parts behind the camera are
        in neither.
    """
    count, length = points.shape[:2]
    pixels = image_points(camera, np.eye(4), points.reshape(-1, 3)).reshape(count, length, 2)
    middles = (pixels[:, :-1] + pixels[:, 1:]) / 2
    drawn = np.isfinite(middles).all(axis=-1)
    hidden = drawn & False if depth is None else depth.hides(middles, (points[:, :-1, 2] + points[:, 1:, 2]) / 2)
    visible: list[Array] = []
    behind: list[Array] = []
    for path, kinds in zip(pixels, np.where(drawn, hidden, -1), strict=True):
        smooth = _without_short(kinds)
        for start, end in _runs(smooth):
            if smooth[start] >= 0:
                (behind if smooth[start] else visible).append(path[start : end + 1])
    return visible, behind


def _runs(kinds: NDArray[np.int64]) -> list[tuple[int, int]]:
    """Where each run of equal numbers begins and ends."""
    starts = np.flatnonzero(np.diff(kinds, prepend=-2)).tolist()
    return list(zip(starts, [*starts[1:], len(kinds)], strict=True))


def _without_short(kinds: NDArray[np.int64]) -> NDArray[np.int64]:
    """The numbers with short runs between two of the same taken for these."""
    smooth = kinds.copy()
    for start, end in _runs(kinds):
        amid = start > 0 and end < len(kinds) and end - start < _SHORT
        if amid and smooth[start - 1] == kinds[end] and kinds[start] >= 0:
            smooth[start:end] = kinds[end]
    return smooth
