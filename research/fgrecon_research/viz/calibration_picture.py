"""Picture of calibration: coverage of regions, and reliability of the facing."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from fgrecon.core.coverage import LEVELS, Coverage, Reliability
from fgrecon.viz import style
from fgrecon.viz.marks import unit
from fgrecon.viz.picture import new_figure

_SIZE = (7.2, 3.5)
_LINES = ("-", "--", ":", "-.")
_MARKS = ("o", "s", "^", "D")


def calibration_picture(regions: Sequence[Coverage], facing: Reliability | None) -> Any:
    """Draw coverage curves, and beside them how often a facing of some probability is right.

    On the dashed diagonal what is claimed is so; below it claims are too sure. Lines and marks differ, not colours
    alone.

    Args:
        facing: Reliability of the facing; None leaves it out.

    Returns:
        A `matplotlib.figure.Figure` with an Agg canvas; see `fgrecon.viz.save_picture`.
    """
    figure = new_figure(*_SIZE)
    figure.set_layout_engine("constrained")
    left, right = figure.subplots(1, 2)
    _frame(left, "Regions", "claimed probability", "share of errors inside")
    for number, one in enumerate(regions):
        kind = {"linestyle": _LINES[number % len(_LINES)], "marker": _MARKS[number % len(_MARKS)]}
        label = f"{one.quantity} ({one.count})"
        left.plot(LEVELS, one.claimed, label=label, markersize=3, color=unit(style.categorical(number)), **kind)
    if regions:
        left.legend(loc="upper left", fontsize=8, frameon=False)
    _frame(right, "Facing", "claimed probability", "share of facings that are right")
    if facing is None or not len(facing.count):
        right.text(0.5, 0.5, "no directions", ha="center", va="center", fontsize=9, color=unit(style.INK))
        return figure
    right.plot(facing.confidence, facing.right, "o-", markersize=4, color=unit(style.categorical(0)))
    low = max(0.0, float(min(facing.confidence.min(), facing.right.min())) - 0.05)
    right.set(xlim=(low, 1.02), ylim=(low, 1.02))
    text = f"expected calibration error {facing.error:.3f}\n{int(facing.count.sum())} results"
    right.text(0.05, 0.97, text, va="top", fontsize=8, transform=right.transAxes, color=unit(style.INK))
    return figure


def _frame(axes: Any, title: str, across: str, up: str) -> None:
    axes.plot((0, 1), (0, 1), "--", color=unit(style.INK), linewidth=0.7)
    axes.set(xlim=(0, 1), ylim=(0, 1), aspect="equal")
    axes.set_title(title, fontsize=9, loc="left", color=unit(style.INK))
    axes.set_xlabel(across, fontsize=8)
    axes.set_ylabel(up, fontsize=8)
    axes.tick_params(labelsize=8)
    axes.spines[["top", "right"]].set_visible(False)
