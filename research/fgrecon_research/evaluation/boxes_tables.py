"""Tables of 3D boxes of several sources against labels, as texts, and in Markdown."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

from fgrecon.core.metrics import THRESHOLDS
from fgrecon.core.text import markdown_row, number_or_dash
from fgrecon_research.evaluation.bootstrap import Interval
from fgrecon_research.evaluation.boxes_summary import LEAST_OVERLAPS, BoxesSummary, Precision

TEXTS = 2
"""Columns of texts, before those of numbers."""


class BoxesTable(NamedTuple):
    """A table."""

    headings: list[str]  # of its columns
    rows: list[list[str]]  # cells of each row


def tables(
    summaries: Mapping[str, Mapping[str, BoxesSummary]], curves: Mapping[str, Sequence[Precision]]
) -> tuple[BoxesTable, BoxesTable, BoxesTable]:
    """Overlaps and angles, errors of the found vehicles, and average precision.

    Args:
        summaries: Of each source its groups.
        curves: Of each source its regimes.
    """
    spaces = [f"{space} IoU ≥ {least:g} %" for space in ("3D", "BEV") for least in LEAST_OVERLAPS]
    shares = BoxesTable(["", "source", "labels", "found", *spaces, *(f"within {most}° %" for most in THRESHOLDS)], [])
    errors = BoxesTable(["", "source", "mean m", "median m", "depth %", "turned %", "size cm", "l, w, h m"], [])
    for group in dict.fromkeys(group for groups in summaries.values() for group in groups):
        for name, groups in summaries.items():
            one = groups[group]
            intervals = [_shown(share, one, 0) for share in (*one.right, *one.ground, *one.within)]
            shares.rows.append([group, name, str(one.vehicles), str(one.found), *intervals])
            errors.rows.append([group, name, *_errors(one)])
    places = [f"{space} {least:g}" for space in ("BEV", "3D") for least in LEAST_OVERLAPS]
    precision = BoxesTable(["AP at 40 points", "source", "labels", "2D 0.7", "AOS", *places], [])
    for i in range(max(map(len, curves.values()), default=0)):
        for name, regimes in curves.items():
            one_regime = regimes[i]
            values = (one_regime.image, one_regime.orientation, *one_regime.ground, *one_regime.volume)
            cells = [number_or_dash(value, ".1f") for value in values]
            precision.rows.append([f"cars, {one_regime.regime}", name, str(one_regime.labels), *cells])
    return shares, errors, precision


def markdown(made: Sequence[BoxesTable]) -> str:
    """The tables in Markdown, an empty line between two."""
    texts = []
    for table in made:
        rule = ["---"] * TEXTS + ["---:"] * (len(table.headings) - TEXTS)
        texts.append("".join(map(markdown_row, (table.headings, rule, *table.rows))))
    return "\n".join(texts)


def _errors(one: BoxesSummary) -> list[str]:
    if one.mean_metres is None:
        return ["-"] * 6
    return [
        _shown(one.mean_metres, one, 2),
        _shown(one.intervals["median_metres"], one, 2),
        f"{one.depth:+.1f}",
        f"{one.turned:.1f}",
        _shown(one.intervals["absolute_size"], one, 0, 100.0),
        ", ".join(f"{error:+.2f}" for error in one.size),
    ]


def _shown(interval: Interval, of: BoxesSummary, digits: int, factor: float = 1.0) -> str:
    """With its interval, where there are several tracks to draw."""
    return interval.shown(digits, factor) if of.tracks > 1 else f"{factor * interval.value:.{digits}f}"
