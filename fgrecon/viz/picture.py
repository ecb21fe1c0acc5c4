"""Pictures of a reconstruction without a viewer: the four panels of the paper's Fig. 2, and contact sheets.

Figures are made with matplotlib's object interface: no pyplot, no window, no global state.
"""

from __future__ import annotations

import io
import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.errors import InvalidInputError
from fgrecon.core.reconstruction import Iteration, Status
from fgrecon.core.text import whole_text
from fgrecon.core.vehicle_mesh import SIDE_COLOURS, Colour, Side
from fgrecon.io.files import check_ending, write_bytes
from fgrecon.viz import style
from fgrecon.viz.describe import describe_bounds, describe_errors, median_residual
from fgrecon.viz.geometry import Box, crop_around, image_points
from fgrecon.viz.marks import draw_badge, draw_box, draw_crop, draw_edges, draw_keypoints, draw_true_box, unit
from fgrecon.viz.solid import draw_from_above, draw_three_quarter
from fgrecon.viz.subjects import SolvedVehicle, Truth, result_step

FORMATS = ("png", "svg", "pdf", "jpg", "jpeg")
"""File types that `save_picture` writes, by the ending of the name."""

_DPI = 150
_ASPECT = 1.25
# Layout in inches: three panels over the photograph, two 3D views, then legend and caption.
_WIDTH, _HEIGHT = 11.0, 3.2
_PANEL, _GAP, _BOTTOM = 2.3, 0.08, 0.92
_CELL, _CELL_HEADING = 3.0, 0.42
CELL_ASPECT = 1.5
"""Width of a sheet's cells relative to their height."""


def picture(vehicle: SolvedVehicle) -> Any:
    """Draw how one vehicle was reconstructed: initial, after pose, after shape, and 3D views.

    Args:
        vehicle: The vehicle, its result with its history. Without an image the panels have a plain canvas; with a truth
            its box is drawn and the errors are written.

    Returns:
        A `matplotlib.figure.Figure` with an Agg canvas; see `save_picture` and `as_rgb`.

    Raises:
        InvalidInputError: The image is not (H, W, 3) of bytes.
    """
    result = vehicle.reconstruction
    figure = new_figure(_WIDTH, _HEIGHT)
    crop = crop_around(vehicle.observation, result.pose.wireframe_uv, aspect=_ASPECT)
    edges, height = style.edges_by_side(result), _PANEL / _ASPECT
    for column, (title, moment) in enumerate(_moments(vehicle)):
        axes = place_axes(figure, _GAP + column * (_PANEL + _GAP), _BOTTOM, _PANEL, height)
        _draw_moment(axes, vehicle, crop, title, moment)
    if vehicle.solved:
        solid = place_axes(figure, 7.32, _BOTTOM, 1.85, height)
        _title(solid, "In 3D", f"from the {draw_three_quarter(solid, result, edges)}")
        above = place_axes(figure, 9.52, _BOTTOM + 0.28, 1.42, height - 0.28)
        draw_from_above(above, result, edges, vehicle.truth)
        _title(above, "From above", "")
    _draw_legend(figure, vehicle.truth)
    look: dict[str, Any] = {"fontsize": 8, "color": unit(style.INK), "va": "top", "parse_math": False}
    figure.text(_GAP / _WIDTH, 0.42 / _HEIGHT, _caption(vehicle), **look)
    return figure


def new_sheet(
    field: str, count: int, columns: int, heading: float, *, cell: float = _CELL, gap: float = _GAP
) -> tuple[Any, list[Any]]:
    """A figure of so many cells, and their axes in the order of reading.

    Args:
        field: What the cells show, for the error.
        count: Number of cells.
        columns: Cells in a row.
        heading: Space above each, inches.
        cell: Width of each, inches.
        gap: Space between them, inches.

    Raises:
        InvalidInputError: There is no cell, or no column.
    """
    if not count:
        raise InvalidInputError(field, "none", "Give at least one vehicle.")
    if columns < 1:
        raise InvalidInputError("columns", columns, "Give a number of at least 1.")
    columns = min(columns, count)
    rows, height = -(-count // columns), cell / CELL_ASPECT
    figure = new_figure(columns * (cell + gap) + gap, rows * (height + heading) + gap)
    cells = []
    for index in range(count):
        row, column = divmod(index, columns)
        bottom = (rows - 1 - row) * (height + heading) + gap
        cells.append(place_axes(figure, gap + column * (cell + gap), bottom, cell, height))
    return figure, cells


def contact_sheet(vehicles: Sequence[SolvedVehicle], *, columns: int = 4) -> Any:
    """Draw the results of many vehicles, one cell each: detected keypoints and the final wireframe.

    Args:
        vehicles: The vehicles, in the order of reading.
        columns: Cells in a row.

    Returns:
        A `matplotlib.figure.Figure` with an Agg canvas.

    Raises:
        InvalidInputError: There is no vehicle, no column, or an image is not (H, W, 3) of bytes.
    """
    figure, cells = new_sheet("vehicles", len(vehicles), columns, _CELL_HEADING)
    for vehicle, axes in zip(vehicles, cells, strict=True):
        crop = crop_around(vehicle.observation, vehicle.reconstruction.pose.wireframe_uv, aspect=CELL_ASPECT)
        _draw_moment(axes, vehicle, crop, _heading(vehicle), _result(vehicle))
    return figure


def as_rgb(figure: Any, dpi: float = _DPI) -> NDArray[np.uint8]:
    """The figure as an RGB image (H, W, 3)."""
    figure.set_dpi(dpi)
    figure.canvas.draw()
    return np.array(figure.canvas.buffer_rgba())[..., :3]


def save_picture(path: str | Path, figure: Any, dpi: float | None = None) -> Path:
    """Write a figure to a file, whole or not at all; the ending of the name chooses the type (see `FORMATS`).

    The same figure gives the same bytes. Without `dpi` it is the figure's own.

    Returns:
        The path written to.

    Raises:
        InvalidInputError: Another ending, or the file cannot be written.
    """
    import matplotlib as mpl

    kind = check_ending(path, FORMATS)
    metadata: dict[str, dict[str, Any]] = {"svg": {"Date": None}, "pdf": {"CreationDate": None}}
    quality: dict[str, Any] = {"pil_kwargs": {"quality": 92}} if kind in ("jpg", "jpeg") else {}
    if kind == "png":  # half the time of the usual 6, for a file that is a twelfth larger
        quality = {"pil_kwargs": {"compress_level": 3}}
    buffer = io.BytesIO()
    with mpl.rc_context({"svg.hashsalt": "fgrecon"}):  # else the names inside an SVG are random
        figure.savefig(buffer, format=kind, dpi=dpi or figure.dpi, metadata=metadata.get(kind), **quality)
    return write_bytes(path, buffer.getvalue())


def new_figure(width: float, height: float, dpi: float = _DPI) -> Any:
    """A figure of a size in inches, with a canvas of its own."""
    from fgrecon.viz.figure import Drawing

    return Drawing(figsize=(width, height), dpi=dpi, facecolor=unit(style.PAPER))


def place_axes(figure: Any, left: float, bottom: float, width: float, height: float) -> Any:
    """Axes at a place given in inches."""
    across, up = figure.get_size_inches()
    return figure.add_axes((left / across, bottom / up, width / across, height / up))


def _moments(vehicle: SolvedVehicle) -> tuple[tuple[str, Iteration | None], ...]:
    """The three panels over the photograph; None where the stage did not run."""
    history = vehicle.reconstruction.diagnostics.history
    pose = [step for step in history if step.stage == "pose"]
    joint = any(step.stage == "joint" for step in history)
    return (
        ("Initial", history[0] if history else None),
        ("After pose adjustment", pose[-1] if pose else None),
        (f"After shape {'and joint ' if joint else ''}adjustment", _result(vehicle)),
    )


def _result(vehicle: SolvedVehicle) -> Iteration | None:
    return result_step(vehicle.reconstruction) if vehicle.solved else None


def _draw_moment(axes: Any, vehicle: SolvedVehicle, crop: Box, title: str, moment: Iteration | None) -> None:
    """One estimate over the photograph, with a title and a line of numbers."""
    draw_crop(axes, vehicle.pixels, vehicle.camera, crop)
    if vehicle.observation.box is not None:
        draw_box(axes, vehicle.observation.box)
    if vehicle.truth is not None:
        draw_true_box(axes, vehicle.truth, vehicle.camera)
    projections, weights, numbers = None, vehicle.observation.confidence, ""
    if moment is not None:
        projections, weights = image_points(vehicle.camera, moment.camera_T_object, moment.keypoints), moment.weights
        draw_edges(axes, projections, style.edges_by_side(vehicle.reconstruction))
        badge = f"{median_residual(vehicle.observation, projections, weights):.1f} px"
        if vehicle.truth is not None:
            numbers = describe_errors(vehicle.truth, moment.camera_T_object, moment.keypoints)
    else:
        badge = "not recorded" if vehicle.solved else "no estimate"
    draw_keypoints(axes, vehicle.observation, weights, projections)
    draw_badge(axes, badge)
    _title(axes, title, numbers)


def _title(axes: Any, title: str, numbers: str) -> None:
    """A title above the axes and a smaller line below it."""
    axes.set_title(title, fontsize=9, loc="left", pad=13, parse_math=False)
    colour = unit(style.FADED)
    axes.annotate(
        numbers, (0, 1), (0, 3), xycoords="axes fraction", textcoords="offset points", fontsize=6.6, color=colour
    )


def _heading(vehicle: SolvedVehicle) -> str:
    status = vehicle.reconstruction.status
    parts = [whole_text(vehicle.title)] if vehicle.title else []  # a file's name need not be UTF-8
    if vehicle.detection:
        parts.append(vehicle.detection)
    if status is not Status.CONVERGED or not parts:
        parts.append(status.value)
    return ", ".join(parts)


def _caption(vehicle: SolvedVehicle) -> str:
    result = vehicle.reconstruction
    sentence = f"{result.status.value.capitalize()}: {result.message.rstrip('.')}."
    if vehicle.solved:
        (x, y, z), (length, width, height) = result.location, result.box_size
        sentence += (
            f" Yaw {np.degrees(result.rotation_y):.1f}°, position ({x:.2f}, {y:.2f}, {z:.2f}) m, "
            f"size {length:.2f} × {width:.2f} × {height:.2f} m. Prior: {result.shape.prior}."
        )
        if bounds := describe_bounds(result):
            sentence += f" Distance and yaw, {bounds}."
        if vehicle.detection:
            sentence += f" Detected: {vehicle.detection}."
        if vehicle.truth is not None:
            errors = describe_errors(vehicle.truth, result.camera_T_object, result.wireframe)
            sentence += f" Error against the truth: {errors}."
    return textwrap.fill(sentence, 175)


def _draw_legend(figure: Any, truth: Truth | None) -> None:
    """What the colours mean, and the scale of weights."""
    from matplotlib.lines import Line2D

    def line(colour: Colour, label: str, width: float = 2.0, dashes: str = "-") -> Any:
        return Line2D([], [], color=unit(colour), linewidth=width, linestyle=dashes, label=label)

    handles = [
        line(SIDE_COLOURS[Side.LEFT], "vehicle's left"),
        line(SIDE_COLOURS[Side.RIGHT], "vehicle's right"),
        line(SIDE_COLOURS[Side.ACROSS], "across"),
        line(style.INK, "keypoint to projection", 1.2),
    ]
    if truth is not None and truth.box_size is not None:
        handles.append(line(style.TRUTH, "true box", 1.2))
    hollow = {"markerfacecolor": unit(style.PAPER), "markeredgecolor": unit(style.INK), "markeredgewidth": 0.7}
    marker: dict[str, Any] = {"linestyle": "", "marker": "o", "markersize": 5, **hollow}
    handles.append(Line2D([], [], label="hidden, filled in (3D)", **marker))
    place = {
        "loc": "upper left",
        "bbox_to_anchor": (_GAP / _WIDTH, 0.74 / _HEIGHT),
        "borderaxespad": 0.0,
        "borderpad": 0.0,
    }
    figure.legend(handles=handles, ncols=len(handles), fontsize=8, frameon=False, columnspacing=1.4, **place)
    scale = place_axes(figure, 9.52, 0.62, 1.3, 0.08)
    scale.imshow(style.weight_colours(np.linspace(0, 1, 128))[None], aspect="auto", extent=(0, 1, 0, 1))
    scale.set_yticks([])
    scale.set_xticks([0, 0.5, 1])
    scale.tick_params(labelsize=7, length=2, pad=1)
    scale.text(-0.05, 0.5, "weight", fontsize=8, ha="right", va="center")
