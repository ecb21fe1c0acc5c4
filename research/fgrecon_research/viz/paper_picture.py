"""The plots of the paper's evaluation, in one figure."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.arrays import Array
from fgrecon.viz import style
from fgrecon.viz.marks import unit
from fgrecon.viz.picture import new_figure
from fgrecon_research.evaluation.bootstrap import Interval
from fgrecon_research.paper.known_shape import KNOWN_SHAPE_ROWS
from fgrecon_research.paper.run import PaperEvaluation
from fgrecon_research.paper.tables import PAPER, Table

_SIZE = 14.0, 17.0  # width and height, inches
_LINES = "-", "--", ":", "-."
_OURS, _OTHER, _PRINTED = unit(style.categorical(1)), unit(style.categorical(0)), unit(style.HAIRLINE)
_KNOWN_SHAPE = "sqpnp", "joint", "joint+others", "sqpnp+size", "joint+size", "joint+size+others"


def paper_picture(found: PaperEvaluation) -> Any:
    """A figure (`fgrecon.viz.save_picture`) of what the tables of the paper's evaluation say."""
    tables, known = {table.key: table for table in found.tables}, found.known
    figure = new_figure(*_SIZE)
    figure.set_layout_engine("constrained")
    grid = figure.add_gridspec(4, 6)
    _precision(_axes(figure, grid[0, :2], "Hard cars within 5 degrees; grey: the paper's figures"), tables["table_1"])
    _errors(_axes(figure, grid[0, 2:4], "Orientation error on Hard (simulated)"), found.orientation)
    _noise(_axes(figure, grid[0, 4:], "Keypoints of the real network and simulated ones"), found.measured)
    for number, key in enumerate(("per_part", "per_part_real"), 1):
        _parts(_axes(figure, grid[number, :], tables[key].title), tables[key])
    measures = (
        ("rotation, degrees", known.rotation, 12.0),
        ("position, % of distance", 100.0 * known.translation, 20.0),
        ("3D keypoint, cm", 100.0 * known.keypoint, 50.0),
    )
    for number, (name, errors, most) in enumerate(measures):
        place = grid[3, 2 * number : 2 * number + 2]
        _known_shape(_axes(figure, place, f"Real cars of known shape: {name}"), errors, most)
    return figure


def _axes(figure: Any, place: Any, title: str) -> Any:
    axes = figure.add_subplot(place)
    axes.set_title(title, fontsize=9, loc="left", color=unit(style.INK))
    axes.tick_params(labelsize=7)
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(alpha=0.3)
    axes.set_axisbelow(True)
    return axes


def _precision(axes: Any, table: Table) -> None:
    """AOP of Table I on the Hard regime at 5 degrees."""
    for place, (label, cells) in enumerate(table.rows):
        cell = cells[6] if isinstance(cells[6], Interval) else Interval(*3 * (cells[6] or 0.0,))
        colour = _PRINTED if label.startswith(PAPER) else _OURS if label.startswith("fgrecon") else _OTHER
        axes.barh(place, cell.value, color=colour, xerr=[[cell.value - cell.low], [cell.high - cell.value]])
        axes.annotate(f" {cell.value:.1f}", (cell.high, place), va="center", fontsize=7)
    axes.set_yticks(range(len(table.rows)), [label for label, _ in table.rows])
    axes.set(xlim=(0, 105), ylim=(len(table.rows) - 0.4, -0.6), xlabel="%")


def _errors(axes: Any, orientation: Mapping[str, Array]) -> None:
    for number, (label, errors) in enumerate(orientation.items()):
        _cumulated(axes, errors, label, number)
    axes.set(xlim=(0, 45), ylim=(0, 102), xlabel="orientation error at most, degrees", ylabel="% of the Hard cars")
    axes.legend(fontsize=7, loc="lower right")


def _noise(axes: Any, measured: Mapping[str, tuple[Array, NDArray[np.bool_]]]) -> None:
    for number, (source, (away, visible)) in enumerate(measured.items()):
        for hidden, name in enumerate(("visible", "hidden")):
            errors = away[(visible != hidden) & np.isfinite(away)]
            _cumulated(axes, errors, f"{name}, {source} ({len(errors)})", 2 * number + hidden)
    axes.set(xlim=(0, 0.5), ylim=(0, 102), xlabel="distance from the truth / longer side of the box", ylabel="%")
    axes.legend(fontsize=7, loc="lower right")


def _cumulated(axes: Any, errors: Array, label: str, number: int) -> None:
    """Percent of errors up to each."""
    style_of = {"color": unit(style.categorical(number)), "ls": _LINES[number % len(_LINES)]}
    axes.plot(np.sort(errors), 100.0 * np.arange(1, len(errors) + 1) / max(len(errors), 1), label=label, **style_of)


def _parts(axes: Any, table: Table) -> None:
    """The paper's per-part figure."""
    width = 0.8 / len(table.columns)
    for number, label in enumerate(table.columns):
        shares = np.nan_to_num([float(cells[number]) for _, cells in table.rows])  # type: ignore[arg-type]
        places = np.arange(len(shares)) + (number - (len(table.columns) - 1) / 2) * width
        axes.bar(places, shares, width, label=label, color=unit(style.categorical(number)))
    axes.set_xticks(range(len(table.rows)), [label.replace("_", "\n") for label, _ in table.rows])
    axes.set(xlim=(-0.6, len(table.rows) - 0.4), ylim=(0, 104), ylabel="APK, %")
    axes.legend(fontsize=7, ncols=len(table.columns), loc="lower right", bbox_to_anchor=(1.0, 1.0))


def _known_shape(axes: Any, errors: Array, most: float) -> None:
    """Distribution of the errors by method."""
    columns = [np.minimum(errors[:, KNOWN_SHAPE_ROWS.index(row)], 1e3) for row in _KNOWN_SHAPE]
    axes.boxplot(columns, showfliers=False, widths=0.6, medianprops={"color": _OURS})
    axes.set_xticks(range(1, len(columns) + 1), [name.replace("+", "\n+") for name in _KNOWN_SHAPE])
    axes.set(ylim=(0, most))
