"""Which parts of lines in space something hides: a depth image of what stands there."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.camera import Camera
from fgrecon.core.geometry import transform
from fgrecon.core.reconstruction import Reconstruction
from fgrecon.viz.geometry import fan, image_points

__all__ = ["DepthImage", "depth_image", "pieces_of", "runs_of"]

_LARGEST = 1500.0  # pixels of a depth image's longer side
_TOLERANCE = 0.4  # metres: lines between points of a surface run below it, as a roof bends over its edges' chords
_PIECES = 16
_SHORT = 4  # pieces of a run that are no run of their own: a mirror hides no edge, a gap shows none


@dataclass(frozen=True, eq=False)
class DepthImage:
    """How far away what covers each pixel is.

    Attributes:
        depth: (h, w) metres; infinite where nothing is.
        scale: Its pixels in a pixel of the image.
    """

    depth: NDArray[np.float32]
    scale: float

    def hides(self, pixels: NDArray[np.float64], depths: NDArray[np.float64]) -> NDArray[np.bool_]:
        """(...) whether something is before points at pixels (..., 2) and depths (...) in metres."""
        height, width = self.depth.shape
        with np.errstate(invalid="ignore"):
            columns, rows = np.rint(np.nan_to_num(pixels, nan=-1.0) * self.scale).astype(np.int64).T
            inside = (columns >= 0) & (columns < width) & (rows >= 0) & (rows < height)
            hidden = np.zeros(inside.shape, dtype=np.bool_)
            hidden[inside] = self.depth[rows[inside], columns[inside]] < depths.T[inside] - _TOLERANCE
        turned: NDArray[np.bool_] = hidden.T
        return turned


def depth_image(results: Iterable[Reconstruction], camera: Camera, size: tuple[float, float]) -> DepthImage:
    """The depth image of vehicles: their surfaces, else the faces of their wireframes.

    Args:
        results: Vehicles with a pose.
        camera: The camera.
        size: Width and height of its image, pixels.
    """
    import cv2

    scale = min(1.0, _LARGEST / max(size))
    depth = np.full((max(round(size[1] * scale), 1), max(round(size[0] * scale), 1)), np.inf, dtype=np.float32)
    pixels, depths = [], []
    for result in results:
        vertices, faces = _surface(result)
        pixels.append(image_points(camera, result.camera_T_object, vertices)[faces])
        depths.append(transform(result.camera_T_object, vertices)[faces][..., 2].mean(axis=1))
    if not pixels:
        return DepthImage(depth, scale)
    corners, far = np.concatenate(pixels) * scale, np.concatenate(depths)
    drawn = np.isfinite(corners).all(axis=(1, 2)) & (np.abs(corners) < 3e4).all(axis=(1, 2))
    corners, far = np.rint(corners[drawn]).astype(np.int32), far[drawn]
    for index in np.argsort(-far):  # the nearest last
        cv2.fillConvexPoly(depth, corners[index], float(far[index]))
    return DepthImage(depth, scale)


def _surface(result: Reconstruction) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Vertices (V, 3) and triangles (F, 3) that hide what is behind them."""
    if result.surface_vertices is not None and result.surface_faces is not None:
        return result.surface_vertices, result.surface_faces
    triangles = [[face[corner] for corner in part] for face in result.faces.values() for part in fan(len(face))]
    return result.wireframe, np.array(triangles, dtype=np.int64).reshape(-1, 3)


def pieces_of(lines: NDArray[np.float64], count: int = _PIECES) -> NDArray[np.float64]:
    """Lines (L, 2, 3) as (L, count + 1, 3) points along each, ends included."""
    along = np.linspace(0.0, 1.0, count + 1)[:, None]
    points: NDArray[np.float64] = lines[:, :1] * (1.0 - along) + lines[:, 1:] * along
    return points


def runs_of(
    points: NDArray[np.float64], camera: Camera, depth: DepthImage
) -> tuple[list[NDArray[np.float64]], list[NDArray[np.float64]]]:
    """What is seen of lines, and what is hidden, as paths in the image.

    Args:
        points: (L, P, 3) points along each, in the camera frame.
        camera: The camera.
        depth: What stands in the way.

    Returns:
        Paths (n, 2) in pixels, n from 2 to P, that are seen, and those that are hidden; parts behind the camera are in
        neither.
    """
    count, length = points.shape[:2]
    pixels = image_points(camera, np.eye(4), points.reshape(-1, 3)).reshape(count, length, 2)
    middles = (pixels[:, :-1] + pixels[:, 1:]) / 2
    hidden = depth.hides(middles, (points[:, :-1, 2] + points[:, 1:, 2]) / 2)
    drawn = np.isfinite(middles).all(axis=-1)
    seen: list[NDArray[np.float64]] = []
    behind: list[NDArray[np.float64]] = []
    for path, kinds in zip(pixels, np.where(drawn, hidden, -1), strict=True):
        smooth = _without_short(kinds)
        for start, end in _runs(smooth):
            if smooth[start] >= 0:
                (behind if smooth[start] else seen).append(path[start : end + 1])
    return seen, behind


def _runs(kinds: NDArray[np.int64]) -> list[tuple[int, int]]:
    """Where each run of equal numbers begins and ends."""
    starts = np.flatnonzero(np.diff(kinds, prepend=-2)).tolist()
    return list(zip(starts, [*starts[1:], len(kinds)], strict=True))


def _without_short(kinds: NDArray[np.int64]) -> NDArray[np.int64]:
    """The numbers with short runs between two of the same taken for these."""
    smooth = kinds.copy()
    for start, end in _runs(kinds):
        if (
            start > 0
            and end < len(kinds)
            and end - start < _SHORT
            and smooth[start - 1] == kinds[end]
            and kinds[start] >= 0
        ):
            smooth[start:end] = kinds[end]
    return smooth
