"""The methods of `fgrecon evaluate video` side by side, as a Markdown table."""

from __future__ import annotations

from collections.abc import Sequence

from fgrecon.core.text import markdown_row, number_or_dash
from fgrecon.evaluation.regions import DIMENSIONS
from fgrecon.evaluation.video_images import VideoBox
from fgrecon.evaluation.video_summary import BoxSummary, group_boxes, methods_of, summarise_boxes

__all__ = ["markdown"]

_HEADINGS = (
    *("boxes", "method", "turned %", "yaw °", "median m", "mean m", "size cm", "jitter °", "jitter m"),
    *(f"{name} NEES" for name in DIMENSIONS),
    "velocity m/s",
)
_GROUPS = ("cars", "all")


def markdown(boxes: Sequence[VideoBox]) -> str:
    """A table with a row for each method on the cars, and on all boxes.

    NEES are squared errors by their covariances: the mean by dimension and the median over that of the chi-square
    distribution, both 1 where covariances are right, and the percent within the 95 % region. In brackets are 95 %
    intervals by bootstrap over tracks.
    """
    lines = [markdown_row(_HEADINGS), markdown_row(["---"] * 2 + ["---:"] * (len(_HEADINGS) - 2))]
    regimes = group_boxes(boxes)["regime"]
    for group in _GROUPS:
        some = regimes.get(group, [])
        named = f"{group}, {len(some)}"
        lines += [markdown_row([named, name, *_cells(summarise_boxes(some, name))]) for name in methods_of(some)]
    return "".join(lines)


def _cells(score: BoxSummary) -> list[str]:
    found = [
        f"{score.turned_round.value:.2f}",
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
    """A number and, where there are several tracks, its 95 % interval."""
    one = score.intervals.get(name)
    if one is None:
        return "-"
    return f"{factor * one.value:.{digits}f}" if score.tracks < 2 else one.shown(digits, factor)
