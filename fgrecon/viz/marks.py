"""Drawing onto a photograph with matplotlib: the crop itself, wireframes, keypoints, residuals, boxes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fgrecon.core.arrays import Array
from fgrecon.core.camera import Camera
from fgrecon.core.observation import Observation
from fgrecon.core.reconstruction import TRUSTED
from fgrecon.core.vehicle_mesh import SIDE_COLOURS, Colour, Side
from fgrecon.viz import style
from fgrecon.viz.geometry import BOX_EDGES, Box, box_path, image_points, outline_corners, resolution
from fgrecon.viz.subjects import Truth

_LINE = 1.6


def unit(colour: ArrayLike) -> Array:
    """8-bit colours (..., 3) as matplotlib takes them, from 0 to 1."""
    return np.asarray(colour, dtype=np.float64) / 255.0


def draw_crop(axes: Any, image: NDArray[np.uint8] | None, camera: Camera | None, crop: Box) -> None:
    """The part of the photograph within the crop, or a plain canvas, in pixel coordinates.

    The canvas has the border of the camera's image, where that is known.
    """
    x1, y1, x2, y2 = crop
    axes.set_facecolor(unit(style.BACKGROUND))
    if image is None and camera is not None:
        width, height = resolution(camera, None)
        xs, ys = (-0.5, width - 0.5, width - 0.5, -0.5, -0.5), (-0.5, -0.5, height - 0.5, height - 0.5, -0.5)
        axes.plot(xs, ys, color=unit(style.HAIRLINE), linewidth=0.8, zorder=0)
    elif image is not None:
        columns = slice(max(int(np.floor(x1)), 0), min(int(np.ceil(x2)) + 1, image.shape[1]))
        rows = slice(max(int(np.floor(y1)), 0), min(int(np.ceil(y2)) + 1, image.shape[0]))
        part = image[rows, columns]
        if part.size:  # pixel centres are at integer coordinates
            extent = (columns.start - 0.5, columns.stop - 0.5, rows.stop - 0.5, rows.start - 0.5)
            axes.imshow(part, extent=extent, interpolation="bilinear", zorder=0)
    axes.set_xlim(x1, x2)
    axes.set_ylim(y2, y1)
    axes.set_aspect("equal")
    axes.set_xticks([])
    axes.set_yticks([])
    for spine in axes.spines.values():
        spine.set_color(unit(style.HAIRLINE))


def draw_edges(axes: Any, points: Array, edges: Mapping[Side, NDArray[np.int64]], alpha: float = 1.0) -> None:
    """A wireframe of points (K, 2), each side in its colour on a light casing; edges with a NaN end are left out."""
    for side in (Side.ACROSS, Side.RIGHT, Side.LEFT):
        if side in edges:
            _draw_lines(axes, points[edges[side]], SIDE_COLOURS[side], _LINE, alpha, zorder=3)


def draw_keypoints(axes: Any, observation: Observation, weights: Array, projections: Array | None) -> None:
    """Detected keypoints, colour and size by weight, each with a line to its projection (K, 2) where one is given."""
    measured = observation.measured
    detected = observation.keypoints[measured]
    if projections is not None:
        lines = np.stack([detected, projections[measured]], axis=1)
        _draw_lines(axes, lines, style.INK, 1.0, 1.0, zorder=4)
    colours = unit(style.weight_colours(weights[measured]))
    sizes = (style.weight_radii(weights[measured], 1.6, 3.2) * 2) ** 2
    axes.scatter(*detected.T, s=sizes, c=colours, edgecolors=[unit(style.PAPER)], linewidths=0.6, zorder=6)


def draw_points(axes: Any, places: Array, weights: Array, colour: Colour, zorder: float) -> None:
    """Points (N, 2) of other sensors: dots of a colour where they are the vehicle's, and faint crosses where not.

    Args:
        axes: The panel.
        places: In its coordinates; those with a NaN are left out.
        weights: (N,) how surely each is the vehicle's.
        colour: Of the vehicle.
        zorder: What they are above.
    """
    used = weights >= TRUSTED
    axes.scatter(*places[~used].T, s=1.0, marker="x", color=[unit(style.FADED)], alpha=0.6, lw=0.2, zorder=zorder)
    axes.scatter(*places[used].T, s=1.2, color=[unit(colour)], edgecolors=[unit(style.PAPER)], lw=0.1, zorder=zorder)


def draw_box(axes: Any, box: Array) -> None:
    """The 2D box (4,) of an observation."""
    corners = box_path(box)
    axes.plot(*corners.T, color=unit(style.PAPER), linewidth=1.3, alpha=0.7, zorder=1)
    axes.plot(*corners.T, color=unit(style.INK), linewidth=0.7, zorder=1)


def draw_grid(axes: Any) -> None:
    """Small ticks and a light grid behind all else."""
    axes.tick_params(labelsize=6, length=2, pad=1.5)
    axes.grid(visible=True, color=unit(style.HAIRLINE), linewidth=0.5)
    axes.set_axisbelow(True)


def draw_badge(axes: Any, text: str) -> None:
    """A short text in the lower left corner, on paper so that it stays legible."""
    box = {"boxstyle": "round,pad=0.25", "facecolor": unit(style.PAPER), "edgecolor": "none", "alpha": 0.85}
    place = {"xycoords": "axes fraction", "textcoords": "offset points"}
    axes.annotate(
        text, (0, 0), (5, 5), fontsize=7, color=unit(style.INK), bbox=box, zorder=8, parse_math=False, **place
    )


def draw_true_box(axes: Any, truth: Truth, camera: Camera) -> None:
    """The true 3D box in the image; nothing where its size is not known."""
    if truth.box_size is not None:
        corners = image_points(camera, truth.camera_T_object, outline_corners(truth.box_size))
        _draw_lines(axes, corners[BOX_EDGES], style.TRUTH, 0.9, 0.9, zorder=2)


def _draw_lines(axes: Any, lines: Array, colour: Colour, width: float, alpha: float, zorder: float) -> None:
    """Line segments (S, 2, 2); those with a point that is not finite are left out."""
    drawn = list(lines[np.isfinite(lines).all(axis=(1, 2))])
    draw_paths(axes, drawn, colour, width, "-", alpha=alpha, zorder=zorder)


def draw_paths(
    axes: Any,
    paths: Sequence[Array],
    colour: Colour,
    width: float,
    dashes: Any,
    *,
    zorder: float,
    alpha: float = 1.0,
    casing: bool = True,
) -> None:
    """Paths (n, 2) of a width in points and a line style of matplotlib.

    The casing is a wider light line below, which keeps them legible on any photograph.
    """
    from matplotlib.collections import LineCollection

    if casing:
        look: dict[str, Any] = {"colors": [unit(style.PAPER)], "linewidths": 1.8 * width, "alpha": 0.7 * alpha}
        axes.add_collection(LineCollection(list(paths), capstyle="round", zorder=zorder, **look))
    cap = "round" if dashes == "-" else "butt"
    look = {"colors": [unit(colour)], "linewidths": width, "alpha": alpha, "linestyles": [dashes]}
    axes.add_collection(LineCollection(list(paths), capstyle=cap, zorder=zorder, **look))
