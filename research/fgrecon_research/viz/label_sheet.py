"""Pictures of keypoint labels: each vehicle with its wireframe, visible keypoints filled and hidden ones as rings."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.observation import Observation
from fgrecon.core.vehicle_mesh import SIDE_COLOURS, edge_sides, keypoint_sides
from fgrecon.io.coco_keypoints import VehicleLabel, VehicleLabels
from fgrecon.viz import style
from fgrecon.viz.geometry import as_image, crop_around
from fgrecon.viz.marks import draw_box, draw_crop, draw_edges, unit
from fgrecon.viz.picture import CELL_ASPECT, new_sheet

_HEADING = 0.3  # inches


def label_sheet(
    labels: VehicleLabels, cells: Sequence[tuple[VehicleLabel, NDArray[np.uint8]]], *, columns: int = 4
) -> Any:
    """Draw labelled vehicles, one cell each.

    Args:
        labels: Where the names and the skeleton of the keypoints are.
        cells: The vehicles to draw, each with its image (H, W, 3), in the order of reading.

    Returns:
        A `matplotlib.figure.Figure` with an Agg canvas.

    Raises:
        InvalidInputError: There is no vehicle, no column, or an image is not (H, W, 3) of bytes.
    """
    figure, places = new_sheet("cells", len(cells), columns, _HEADING)
    for axes, (vehicle, image) in zip(places, cells, strict=True):
        _draw(axes, labels, vehicle, image)
    return figure


def _draw(axes: Any, labels: VehicleLabels, vehicle: VehicleLabel, image: NDArray[np.uint8]) -> None:
    points, visible = vehicle.keypoints, vehicle.flags == 2
    sides = keypoint_sides(labels.keypoints, np.zeros((len(points), 3)))
    edges = edge_sides(np.array(labels.skeleton, dtype=np.int64).reshape(-1, 2), sides)
    draw_crop(
        axes, as_image(image), None, crop_around(Observation.of(points, box=vehicle.box), points, aspect=CELL_ASPECT)
    )
    draw_box(axes, vehicle.box)
    draw_edges(axes, points, edges, alpha=0.6)
    colours = np.array([unit(SIDE_COLOURS[side]) for side in sides])
    paper = [unit(style.PAPER)]
    axes.scatter(*points[visible].T, s=20, c=colours[visible], edgecolors=paper, linewidths=0.7, zorder=6)
    axes.scatter(*points[~visible].T, s=14, c=paper, edgecolors=colours[~visible], linewidths=1.0, zorder=5)
    text = f"{vehicle.image.drive} {vehicle.image.frame}, {vehicle.kind} {vehicle.track}: {visible.sum()} visible"
    axes.set_title(text, fontsize=7.5, loc="left", pad=4, color=unit(style.INK), parse_math=False)
