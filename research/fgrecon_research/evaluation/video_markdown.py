"""The methods of `fgrecon evaluate video` side by side, as Markdown tables: one for each way to group the boxes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from fgrecon.calibration.labelled_boxes import VideoBox
from fgrecon.calibration.regions import DIMENSIONS
from fgrecon.core.metrics import THRESHOLDS
from fgrecon.core.text import markdown_row, number_or_dash
from fgrecon_research.evaluation.bootstrap import Interval
from fgrecon_research.evaluation.video_summary import BoxSummary, group_boxes, methods_of, summarise_boxes

_HEADINGS = (
    *("boxes", "method", *(f"AOP {threshold}° %" for threshold in THRESHOLDS), "turned %", "yaw °"),
    *("median m", "mean m", "size cm", "jitter °", "jitter m", *(f"{name} NEES" for name in DIMENSIONS)),
    "velocity m/s",
)
_FIRST = "regime"


def markdown(boxes: Sequence[VideoBox]) -> str:
    """A table for each of the groupings of `group_boxes`, regimes first, with a row for each group and method.

    NEES are squared errors by their covariances: the mean by dimension and the median over that of the chi-square
    distribution, both 1 where covariances are right, and the percent within the 95 % region. In brackets are 95 %
    intervals by bootstrap over tracks.
    """
    groups = group_boxes(boxes)
    order = sorted(groups, key=lambda by: by != _FIRST)
    return "\n".join(f"By {by}:\n\n{_table(groups[by])}" for by in order)


def _table(named: Mapping[str, Sequence[VideoBox]]) -> str:
    head = [markdown_row(_HEADINGS), markdown_row(["---"] * 2 + ["---:"] * (len(_HEADINGS) - 2))]
    rows = [
        markdown_row([f"{name}, {len(some)}", method, *_cells(summarise_boxes(some, method))])
        for name, some in named.items()
        for method in methods_of(some)
    ]
    return "".join(head + rows)


def _cells(score: BoxSummary) -> list[str]:
    found = [
        *(_shown(score, share, 1) for share in score.aop.values()),
        _shown(score, score.turned_round, 2),
        f"{score.mean_degrees.value:.2f}",
        _within(score, "median_metres", 3),
        _within(score, "mean_metres", 3),
        _within(score, "mean_absolute_size_error", 1, 100.0),
        number_or_dash(score.jitter_degrees, ".2f"),
        number_or_dash(score.jitter_metres, ".3f"),
    ]
    for name in DIMENSIONS:
        one = score.consistency.get(name)
        found.append("-" if one is None else f"{one.mean:.1f} / {one.median:.2f} / {one.inside:.0f} %")
    return [*found, _within(score, "median_velocity", 2)]


def _within(score: BoxSummary, name: str, digits: int, factor: float = 1.0) -> str:
    """A number that a group may lack, with its interval."""
    one = score.intervals.get(name)
    return "-" if one is None else _shown(score, one, digits, factor)


def _shown(score: BoxSummary, one: Interval, digits: int, factor: float = 1.0) -> str:
    """A number and, where there are several tracks, its 95 % interval."""
    return f"{factor * one.value:.{digits}f}" if score.tracks < 2 else one.shown(digits, factor)
