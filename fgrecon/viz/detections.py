"""Pictures of detected keypoints: the network's crop, with every keypoint, its name and its confidence."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.category import Category
from fgrecon.core.vehicle_mesh import SIDE_COLOURS, Side
from fgrecon.viz import style
from fgrecon.viz.geometry import box_path
from fgrecon.viz.marks import unit
from fgrecon.viz.picture import new_figure

if TYPE_CHECKING:
    from fgrecon.perception.keypoints.detect import CascadeDetection

_CELL, _COLUMNS, _HEADING, _DPI = 3.2, 4, 0.3, 100
_SHOWN = 0.3  # points of less confidence are rings without a name


def detection_sheet(
    image: NDArray[np.uint8], detections: Sequence[CascadeDetection], names: Sequence[str], category: Category
) -> Any:
    """One cell per vehicle: filled dots are trusted keypoints, rings those that are hidden or unsure.

    Args:
        image: (H, W, 3) RGB.
        detections: What was detected.
        names: Heading of each cell.
        category: Names of the keypoints; left and right are coloured apart.

    Returns:
        A `matplotlib.figure.Figure` with an Agg canvas.
    """
    columns = max(min(_COLUMNS, len(detections)), 1)
    rows = max(-(-len(detections) // columns), 1)
    figure = new_figure(columns * _CELL, rows * (_CELL + _HEADING), dpi=_DPI)
    for number, (detection, name) in enumerate(zip(detections, names, strict=True)):
        axes = figure.add_subplot(rows, columns, number + 1)
        _draw(axes, image, detection, category)
        towards = np.degrees(2 * np.pi * detection.azimuth.argmax() / len(detection.azimuth))
        axes.set_title(
            f"{name}: seen from {(towards + 180) % 360 - 180:.0f}°", fontsize=8, color=unit(style.INK), parse_math=False
        )
    figure.tight_layout(pad=0.4)
    return figure


def _draw(axes: Any, image: NDArray[np.uint8], detection: CascadeDetection, category: Category) -> None:
    crop, observation = detection.crop, detection.observation
    low, high = crop.centre - crop.side / 2, crop.centre + crop.side / 2
    height, width = image.shape[:2]
    x1, y1 = np.clip(np.floor(low).astype(int), 0, [width - 1, height - 1])
    x2, y2 = np.clip(np.ceil(high).astype(int) + 1, [x1 + 1, y1 + 1], [width, height])
    axes.imshow(image[y1:y2, x1:x2], extent=(x1 - 0.5, x2 - 0.5, y2 - 0.5, y1 - 0.5), interpolation="bilinear")
    axes.set_facecolor(unit(style.BACKGROUND))
    axes.set_xlim(low[0], high[0])
    axes.set_ylim(high[1], low[1])
    axes.set_xticks([])
    axes.set_yticks([])
    sides = [SIDE_COLOURS[Side.LEFT if name.startswith("left") else Side.RIGHT] for name in category.keypoints]
    points = zip(observation.keypoints, observation.confidence, sides, strict=True)
    for keypoint, (point, sure, colour) in enumerate(points, start=1):
        shown = sure >= _SHOWN
        axes.plot(
            *point,
            marker="o",
            markersize=3 + 4 * sure,
            markerfacecolor=unit(colour) if shown else "none",
            markeredgecolor="white" if shown else unit(colour),
            markeredgewidth=0.8,
        )
        if shown:
            axes.annotate(str(keypoint), point, xytext=(4, 2), textcoords="offset points", fontsize=6, color="white")
    if observation.box is not None:
        axes.plot(*box_path(observation.box).T, color=unit(style.HAIRLINE), linewidth=0.8)
