"""A picture of a shape prior: its mean and each mode at -2 and +2 standard deviations, from three views."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.arrays import Array
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.shape_prior import ShapePrior
from fgrecon.core.vehicle_mesh import SIDE_COLOURS, Side, edge_sides, keypoint_sides
from fgrecon.viz import style
from fgrecon.viz.marks import draw_edges, unit
from fgrecon.viz.picture import new_figure

MODE_RANGE = 2.0
"""How far each mode is shown, in standard deviations."""

_VIEWS = {"from the right": (0, 1, 1, -1), "from the front": (2, 1, 1, -1), "from above": (0, 2, 1, 1)}
"""Horizontal and vertical object axis of each view, and their signs on paper."""
_CELL = (3.4, 2.3)
_TITLE, _DPI = 0.35, 100


def prior_picture(prior: ShapePrior, modes: int | None = None) -> Any:
    """Draw a prior: one row for the mean and one per mode, three views each.

    In a mode's rows the mean is drawn faintly; vermilion and blue keep to the vehicle's sides, and what a coefficient
    of +2 does is drawn solid, of -2 dashed.

    Args:
        modes: How many of its modes to draw; all by default.

    Returns:
        A `matplotlib.figure.Figure` with an Agg canvas; see `fgrecon.viz.save_picture`.

    Raises:
        InvalidInputError: The prior has fewer modes.
    """
    count = prior.dimension if modes is None else modes
    if not 0 <= count <= prior.dimension:
        raise InvalidInputError("modes", count, f"Give a number from 0 to {prior.dimension}.")
    width, height = 3 * _CELL[0], (count + 1) * _CELL[1] + _TITLE
    figure = new_figure(width, height, dpi=_DPI)
    edges = edges_of(prior)
    extremes = _extremes(prior, count)
    limits = {name: _limits(extremes, view) for name, view in _VIEWS.items()}
    for row in range(count + 1):
        for column, (name, view) in enumerate(_VIEWS.items()):
            top = 1.0 - (_TITLE + (row + 1) * _CELL[1]) / height
            axes = figure.add_axes(
                (column / 3 + 0.025, top + 0.06 * _CELL[1] / height, 1 / 3 - 0.035, 0.82 * _CELL[1] / height)
            )
            _draw_cell(axes, prior, extremes[:, row], view, edges, mean=row == 0)
            _frame(axes, *limits[name])
            title = name if row == 0 else ""
            if column == 0:
                title = f"mean, {name}" if row == 0 else _mode_title(prior, row - 1)
            axes.set_title(title, fontsize=8, loc="left", color=unit(style.INK), parse_math=False)
    total = f"{100 * prior.explained[:count].sum():.1f} % of the variance" if count else "mean alone"
    heading = f"{prior.name} ({prior.category.name}): {total}; solid +2, dashed -2 standard deviations; metres"
    figure.text(
        0.01, 1.0 - 0.35 * _TITLE / height, heading, fontsize=9, va="top", color=unit(style.INK), parse_math=False
    )
    return figure


def edges_of(prior: ShapePrior) -> dict[Side, NDArray[np.int64]]:
    """The edges (E, 2) of a prior's wireframe by side."""
    sides = keypoint_sides(prior.category.keypoints, prior.mean)
    return edge_sides(np.array(prior.category.edges, dtype=np.int64).reshape(-1, 2), sides)


def _extremes(prior: ShapePrior, count: int) -> Array:
    """(2, count + 1, K, 3) shapes at -2 and +2 of the mean (no change) and of each mode."""
    change = np.concatenate([np.zeros((1, *prior.mean.shape)), prior.basis[:count]])
    return prior.mean + MODE_RANGE * np.array([-1.0, 1.0])[:, None, None, None] * change


def _flat(points: Array, view: tuple[int, int, int, int]) -> Array:
    across, up, sign_across, sign_up = view
    return np.stack([sign_across * points[..., across], sign_up * points[..., up]], axis=-1)


def _limits(extremes: Array, view: tuple[int, int, int, int]) -> tuple[Array, float]:
    flat = _flat(extremes, view).reshape(-1, 2)
    low, high = flat.min(axis=0), flat.max(axis=0)
    half = 0.55 * max(float(high[0] - low[0]), float(high[1] - low[1]) * _CELL[0] / (0.82 * _CELL[1]))
    return 0.5 * (low + high), half


def _frame(axes: Any, centre: Array, half: float) -> None:
    ratio = 0.82 * _CELL[1] / _CELL[0]
    axes.set_xlim(centre[0] - half, centre[0] + half)
    axes.set_ylim(centre[1] - half * ratio, centre[1] + half * ratio)
    axes.set_aspect("equal")
    axes.tick_params(labelsize=5, length=2, colors=unit(style.FADED))
    for spine in axes.spines.values():
        spine.set_color(unit(style.HAIRLINE))


def _draw_cell(
    axes: Any,
    prior: ShapePrior,
    extremes: Array,
    view: tuple[int, int, int, int],
    edges: dict[Side, NDArray[np.int64]],
    *,
    mean: bool,
) -> None:
    from matplotlib.collections import LineCollection

    middle = _flat(prior.mean, view)
    draw_edges(axes, middle, edges, alpha=1.0 if mean else 0.18)
    if mean:
        axes.scatter(*middle.T, s=8, color=unit(style.INK), linewidths=0, zorder=5)
        return
    for shape, dashes in zip(extremes, ("--", "-"), strict=True):
        flat = _flat(shape, view)
        for side, group in edges.items():
            colour = unit(SIDE_COLOURS[side])
            axes.add_collection(LineCollection(list(flat[group]), colors=[colour], linestyles=dashes, linewidths=1.0))
    ends = _flat(extremes, view)
    axes.add_collection(LineCollection(list(ends.swapaxes(0, 1)), colors=[unit(style.UNCERTAINTY)], linewidths=1.2))


def _mode_title(prior: ShapePrior, mode: int) -> str:
    change = MODE_RANGE * (prior.box_size(np.eye(prior.dimension)[mode]) - prior.box_size(np.zeros(prior.dimension)))
    sizes = ", ".join(f"{n} {100 * c:+.0f}" for n, c in zip(("length", "width", "height"), change, strict=True))
    return f"mode {mode + 1}: {100 * prior.explained[mode]:.1f} %; at +2: {sizes} cm"
