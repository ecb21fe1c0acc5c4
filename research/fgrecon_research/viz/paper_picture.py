"""Picture of the paper's evaluation: the precision of Table I, and the right keypoints part by part, as bars."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from fgrecon.viz import style
from fgrecon.viz.marks import unit
from fgrecon.viz.picture import new_figure
from fgrecon_research.evaluation.bootstrap import Interval
from fgrecon_research.paper.tables import Table

_SIZE = 12.0, 14.0  # width and height, inches
_COLUMNS = {"table_1": "≤5°", "per_part": "", "per_part_real": ""}  # what headings of drawn columns end with, by table


def paper_picture(tables: Sequence[Table]) -> Any:
    """A figure (`fgrecon.viz.save_picture`) of those of the tables that are figures in the paper, or one row of one."""
    figure = new_figure(*_SIZE)
    figure.set_layout_engine("constrained")
    drawn = [table for table in tables if table.key in _COLUMNS]
    for axes, table in zip(figure.subplots(len(drawn), 1, squeeze=False).flat, drawn, strict=True):
        _bars(axes, table, [i for i, name in enumerate(table.columns) if name.endswith(_COLUMNS[table.key])])
    return figure


def _bars(axes: Any, table: Table, columns: Sequence[int]) -> None:
    """Percent by row, a colour for each column, with the intervals that there are."""
    labels, rows = zip(*table.rows, strict=True)
    for number, column in enumerate(columns):
        cells = (row[column] for row in rows)
        known = [(c.value, c.low, c.high) if isinstance(c, Interval) else (c,) * 3 for c in cells]
        value, low, high = np.array(known, dtype=float).T  # None becomes NaN, which has no bar
        places = np.arange(len(rows)) + (number - (len(columns) - 1) / 2) * 0.8 / len(columns)
        how = {"label": table.columns[column], "color": unit(style.categorical(number))}
        axes.bar(places, value, 0.8 / len(columns), yerr=(value - low, high - value), **how)
    axes.set_title(table.title, fontsize=9, loc="left", color=unit(style.INK))
    axes.set_xticks(range(len(rows)), labels, rotation=20, ha="right", fontsize=7)
    axes.set(ylim=(0, 104), ylabel="%")
    axes.legend(fontsize=7, ncols=len(columns), loc="lower right", bbox_to_anchor=(1.0, 1.0), frameon=False)
