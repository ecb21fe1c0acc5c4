"""The table and legend beside a scene from above."""

from __future__ import annotations

import textwrap
from dataclasses import dataclass
from typing import Any

import numpy as np

from fgrecon.core.arrays import Array
from fgrecon.core.reconstruction import Status
from fgrecon.core.vehicle_mesh import Colour
from fgrecon.viz import style
from fgrecon.viz.describe import LEVEL, bounds_of, describe_bounds
from fgrecon.viz.from_above import DASHES, FONT, START_DASHES, TRUE_DASHES
from fgrecon.viz.marks import draw_points, unit
from fgrecon.viz.subjects import ORIENTATION_ERROR, TRANSLATION_ERROR, DrawnScene, DrawnVehicle

_MINUS = str.maketrans("-", "−")
_WORDS = 30  # characters of a model's name
_WIDE = 100.0  # metres from which on there is no room for a decimal
_ROUGH = 10.0  # metres: to so much a distance is known whose decimal tells nothing


@dataclass(frozen=True)
class Row:
    """What is written of a vehicle."""

    name: str  # on its plate
    cells: tuple[str, ...]  # its numbers, in columns
    details: tuple[str, ...] = ()  # lines below, where there is room


@dataclass(frozen=True)
class ScenePage:
    """The table of a scene."""

    columns: tuple[tuple[str, float], ...]  # heading of each after the name, and its right edge relative to the panel
    rows: tuple[Row, ...]  # a row for each vehicle, the nearest first

    @property
    def lines(self) -> int:
        """Lines that it takes, with the rule below its headings."""
        return 2 + sum(1 + len(row.details) for row in self.rows)


def scene_page(scene: DrawnScene) -> ScenePage:
    """The table of a scene's vehicles, the nearest first.

    Where the truth is known it has the errors, of the start as well where that is given; else the estimate's values
    with what they are known to with a confidence of 95 %.
    """
    vehicles = scene.vehicles
    ordered = sorted(vehicles, key=lambda v: np.inf if v.pose is None else float(np.linalg.norm(v.pose[:3, 3])))
    few = not scene.crowded
    words, detected = any(vehicle.words for vehicle in vehicles), any(vehicle.detection for vehicle in vehicles)
    columns: tuple[tuple[str, float], ...] = (("distance [m]", 0.58), ("yaw [°]", 1.0))
    cells = [_values(v) for v in ordered]
    if any(vehicle.truth is not None for vehicle in vehicles):
        columns = (("position error [m]", 0.6), ("yaw [°]", 1.0))
        cells = [_errors(v, scene.starts.get(v.identity)) for v in ordered]
    elif not few and detected:
        columns = (("dist. [m]", 0.44), ("yaw [°]", 0.685), ("detected", 1.0))
        cells = [
            (distance, yaw.partition(" ")[0], v.detection) for v, (distance, yaw) in zip(ordered, cells, strict=True)
        ]
    elif not few and not words:
        columns = (("dist. [m]", 0.48), ("yaw [°]", 0.82), ("l [m]", 1.0))
        lengths = ["" if v.posed is None else f"{v.posed[0].box_size[0]:.1f}" for v in ordered]
        cells = [(*pair, length) for pair, length in zip(cells, lengths, strict=True)]
    details = [_details(v) if few else tuple(filter(None, (v.words,))) for v in ordered]
    rows = (Row(v.label, c, d) for v, c, d in zip(ordered, cells, details, strict=True))
    return ScenePage(columns, tuple(rows))


def _values(vehicle: DrawnVehicle) -> tuple[str, ...]:
    """Distance and yaw; where the pose is not known, what became of it."""
    if vehicle.posed is None:
        return ("refused" if vehicle.result is None else vehicle.result.status.value, "")
    result, _ = vehicle.posed
    distance, yaw = float(np.linalg.norm(result.location)), float(np.degrees(result.rotation_y))
    bounds = bounds_of(result)
    digits = 1 if distance < _WIDE and (bounds is None or bounds[0] < _ROUGH) else 0
    if bounds is None:
        return (f"{distance:.{digits}f}", f"{yaw:.0f}".translate(_MINUS))
    return (_within(distance, bounds[0], distance, digits), _within(yaw, bounds[1], 180.0, 0))


def _within(value: float, spread: float, most: float, digits: int) -> str:
    """A value with how well it is known; a word where that is no better than the most that it can be off."""
    return f"{value:.{digits}f} ± {spread:.{digits}f}".translate(_MINUS) if spread < most else "unknown"


def _details(vehicle: DrawnVehicle) -> tuple[str, ...]:
    """Lines below the numbers: what was detected, size and status, and beside errors how far the result is known."""
    known = "" if vehicle.posed is None or vehicle.truth is None else describe_bounds(vehicle.posed[0])
    return tuple(filter(None, (vehicle.detection, _detail(vehicle), known)))


def _detail(vehicle: DrawnVehicle) -> str:
    """The words of a vehicle, its size and status; or the car model that it is like."""
    if vehicle.posed is None:
        return vehicle.words
    if vehicle.model is not None:
        return textwrap.shorten(f"like {vehicle.model.name}", _WORDS, placeholder="…")
    size = " × ".join(f"{metres:.1f}" for metres in vehicle.posed[0].box_size)
    return ", ".join(part for part in (f"{size} m", vehicle.words or vehicle.posed[0].status.value) if part)


def _errors(vehicle: DrawnVehicle, start: Array | None) -> tuple[str, ...]:
    """Errors of position and yaw, from the start to the result where that is given."""
    if vehicle.posed is None or vehicle.truth is None:
        return ("", "")
    result, pose = vehicle.posed
    after = vehicle.truth.errors(pose, result.wireframe)
    ends = f"{after[TRANSLATION_ERROR]:.2f}", f"{after[ORIENTATION_ERROR]:.1f}"
    if start is None:
        return ends
    first = vehicle.truth.errors(start, result.diagnostics.history[0].keypoints)
    return f"{first[TRANSLATION_ERROR]:.2f} → {ends[0]}", f"{first[ORIENTATION_ERROR]:.1f} → {ends[1]}"


def draw_table(axes: Any, page: ScenePage, room: int, lines: float) -> float:
    """Write the table at the top of a panel that is so many lines high; it may have `room` of them.

    Returns:
        How many lines it took.
    """
    axes.set_axis_off()
    axes.set_xlim(0.0, 1.0)
    axes.set_ylim(lines, 0.0)
    look: dict[str, Any] = {"fontsize": FONT, "va": "center", "parse_math": False}
    for text, right in page.columns:
        axes.text(right, 0.5, text, ha="right", color=unit(style.FADED), **look)
    axes.plot([0.0, 1.0], [1.0, 1.0], color=unit(style.HAIRLINE), linewidth=0.5)
    y, left = 1.1, len(page.rows)
    for row in page.rows:
        if y + 1 + len(row.details) + (left > 1) > room:
            break
        axes.text(0.02, y + 0.5, row.name, fontweight="bold", color=unit(style.INK), **look)
        for text, (_, right) in zip(row.cells, page.columns, strict=False):
            axes.text(right, y + 0.5, text, ha="right", color=unit(style.INK), **look)
        for line, text in enumerate(row.details, start=1):
            axes.text(1.0, y + line + 0.42, text, ha="right", color=unit(style.FADED), **look)
        y, left = y + 1 + len(row.details), left - 1
    if left:
        axes.text(0.02, y + 0.5, f"and {left} more", color=unit(style.FADED), **look)
        y += 1
    return y + 0.4


def draw_key(axes: Any, scene: DrawnScene, room: float, lines: float, scale: float) -> None:
    """What the lines mean, as far as they are there, below the table.

    Args:
        axes: The panel.
        scene: What is shown.
        room: Lines that are left.
        lines: How many lines high the panel is.
        scale: How many times larger ellipses are drawn.
    """
    solved = [result for _, result, _ in scene.posed]
    ink, there = style.INK, {result.status for result in solved}
    entries: list[tuple[Any, Colour, str]] = [(DASHES[s], ink, s.value) for s in Status if s in there]
    if len(solved) < len(scene.vehicles):
        entries.append((DASHES[Status.FAILED], ink, "no pose: 2D box"))
    if scene.starts:
        entries.append((START_DASHES, style.FADED, "start"))
    if any(vehicle.truth is not None for vehicle in scene.vehicles):
        entries.append((TRUE_DASHES, style.TRUTH, "truth"))
    y = lines - room
    for dashes, colour, text in entries:
        axes.plot([0.02, 0.16], [y + 0.5, y + 0.5], color=unit(colour), linewidth=1.1, linestyle=dashes)
        axes.text(0.21, y + 0.5, text, fontsize=FONT, va="center", color=unit(ink))
        y += 1.0
    if any(len(result.diagnostics.points) for result in solved):
        draw_points(axes, np.array([(0.05, y + 0.5), (0.13, y + 0.5)]), np.array([1.0, 0.0]), ink, zorder=1)
        axes.text(0.21, y + 0.5, "points: used, not used", fontsize=FONT, va="center", color=unit(ink))
        y += 1.0
    if any(result.uncertainty.pose_covariance is not None for result in solved):
        from matplotlib.patches import Ellipse

        axes.add_patch(Ellipse((0.09, y + 0.5), 0.13, 0.6, facecolor=(*unit(ink), 0.25), edgecolor=unit(ink), lw=0.7))
        larger = "" if scale == 1.0 else f" ({scale:.0f} ×)"
        axes.text(0.21, y + 0.5, f"{100 * LEVEL:.0f} % of position{larger}", fontsize=FONT, va="center")
