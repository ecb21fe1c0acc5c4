"""The 3D panels of a picture: a shaded orthographic view and a view from above, drawn with flat matplotlib axes.

Matplotlib's own 3D axes are slow and hard to frame; a car needs no more than sorted, shaded triangles.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.arrays import Array
from fgrecon.core.geometry import transform
from fgrecon.core.reconstruction import Reconstruction
from fgrecon.core.vehicle_mesh import SURFACE, Side
from fgrecon.viz import style
from fgrecon.viz.geometry import BOX_EDGES, outline_corners
from fgrecon.viz.marks import draw_edges, draw_grid, unit
from fgrecon.viz.occlusion import shading
from fgrecon.viz.subjects import Truth

_OBLIQUE, _ELEVATION = np.radians(52.0), np.radians(18.0)
_LIGHT = np.array([0.35, 0.55, 0.75])
_HIDDEN = 0.5


def draw_three_quarter(axes: Any, reconstruction: Reconstruction, edges: Mapping[Side, NDArray[np.int64]]) -> str:
    """The surface and wireframe from above the corner that the camera sees; keypoints that it cannot see are hollow.

    Returns:
        Which corner that is: `front left`, `front right`, `rear left` or `rear right`.
    """
    eye = -reconstruction.camera_T_object[:3, :3].T @ reconstruction.camera_T_object[:3, 3]
    front, left = eye[0] >= 0, eye[2] >= 0
    azimuth = _OBLIQUE if front else np.pi - _OBLIQUE
    view = _view(azimuth if left else -azimuth, _ELEVATION)
    far = Side.RIGHT if left else Side.LEFT
    if reconstruction.shape.surface_vertices is not None and reconstruction.shape.surface_faces is not None:
        _shade(axes, reconstruction.shape.surface_vertices @ view.T, reconstruction.shape.surface_faces)
    points = reconstruction.wireframe @ view.T
    # The far side shows through faintly.
    draw_edges(axes, points[:, :2], {side: e for side, e in edges.items() if side is far}, alpha=0.45)
    draw_edges(axes, points[:, :2], {side: e for side, e in edges.items() if side is not far})
    hidden = reconstruction.diagnostics.visibility < _HIDDEN
    colours = unit(style.weight_colours(reconstruction.diagnostics.weights))
    look: dict[str, Any] = {"s": 16, "edgecolors": [unit(style.INK)], "linewidths": 0.7, "zorder": 5}
    for chosen, faces in ((hidden, np.broadcast_to(unit(style.PAPER), colours.shape)), (~hidden, colours)):
        axes.scatter(*points[chosen, :2].T, c=faces[chosen], **look)
    axes.set_aspect("equal", adjustable="datalim")
    axes.margins(0.04)
    axes.set_axis_off()
    return f"{'front' if front else 'rear'} {'left' if left else 'right'}"


def draw_from_above(
    axes: Any, reconstruction: Reconstruction, edges: Mapping[Side, NDArray[np.int64]], truth: Truth | None
) -> None:
    """The wireframe and its box on the ground as seen from above: camera x to the right, z upwards, in metres."""
    boxes = [(reconstruction.camera_T_object, reconstruction.box_size, style.INK, "-")]
    if truth is not None and truth.box_size is not None:
        boxes.append((truth.camera_T_object, truth.box_size, style.TRUTH, "--"))
    for pose, size, colour, line in boxes:
        corners = transform(pose, outline_corners(size)[BOX_EDGES[:4, 0]])
        nose = transform(pose, np.array([(size[0] / 2, 0, 0), (size[0] / 2 + 0.8, 0, 0)]))
        for path in (corners[[0, 1, 2, 3, 0]], nose):
            axes.plot(path[:, 0], path[:, 2], color=unit(colour), linestyle=line, linewidth=1.0, zorder=2)
    points = transform(reconstruction.camera_T_object, reconstruction.wireframe)
    draw_edges(axes, points[:, [0, 2]], edges)
    axes.set_aspect("equal", adjustable="datalim")
    axes.margins(0.08)
    axes.set_xlabel("right of the camera [m]", fontsize=7, labelpad=1)
    axes.set_ylabel("ahead [m]", fontsize=7, labelpad=1)
    draw_grid(axes)


def _view(azimuth: float, elevation: float) -> Array:
    """(3, 3) object axes to (right, up, towards the eye); azimuth 0 looks at the nose, positive from the left."""
    towards = np.array([np.cos(azimuth) * np.cos(elevation), -np.sin(elevation), np.sin(azimuth) * np.cos(elevation)])
    up = np.array([0.0, -1.0, 0.0]) - (np.array([0.0, -1.0, 0.0]) @ towards) * towards
    up /= np.linalg.norm(up)
    return np.stack([np.cross(up, towards), up, towards])


def _shade(axes: Any, vertices: Array, faces: NDArray[np.int64]) -> None:
    """Triangles in (right, up, towards the eye), far ones first, lit from above the eye's left shoulder."""
    from matplotlib.collections import PolyCollection

    corners = vertices[faces]
    light = shading(corners, _LIGHT, np.broadcast_to([0.0, 0.0, 1.0], (len(corners), 3)))
    order = np.argsort(corners[:, :, 2].mean(axis=1))
    colours = np.clip(unit(SURFACE) * light[order, None] * 1.12, 0.0, 1.0)
    # Rasterised: thousands of tiny triangles would swell a vector file. Their own colour on the edges closes seams.
    mesh = PolyCollection(
        list(corners[order, :, :2]), facecolors=colours, edgecolors=colours, linewidths=0.3, rasterized=True, zorder=1
    )
    axes.add_collection(mesh)
