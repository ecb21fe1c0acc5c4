"""The methods of `fgrecon evaluate video` side by side: a table for each way to group the boxes."""

from __future__ import annotations

from fgrecon.calibration.regions import DIMENSIONS
from fgrecon_research.evaluation.bootstrap import Interval
from fgrecon_research.evaluation.measures import THRESHOLDS
from fgrecon_research.evaluation.text_table import TextTable, number_or_dash
from fgrecon_research.evaluation.video_summary import PoseSummary, Summaries

_HEADINGS = (
    *("boxes", "method", *(f"AOP {threshold}° %" for threshold in THRESHOLDS), "flipped %", "silent %", "network %"),
    *(
        "yaw °",
        "median m",
        "mean m",
        "IoU 0.7 %",
        "length cm",
        "size cm",
        "jitter °",
        "jitter m",
        *(f"{name} NEES" for name in DIMENSIONS),
    ),
    *("velocity m/s", "refused"),
)
_FIRST = "regime"


def tables(summaries: Summaries) -> dict[str, TextTable]:
    """A table by what the groups are formed by, regimes first, with a row for each group and method.

    NEES are squared errors by their covariances: the mean by dimension and the median over that of the chi-square
    distribution, both 1 where covariances are right, and the percent within the 68 % and the 95 % region. In brackets
    are 95 % intervals by bootstrap over tracks.
    """
    made = {}
    for by in sorted(summaries, key=lambda by: by != _FIRST):
        rows = [
            [f"{name}, {score.boxes}", method, *_cells(score)]
            for name, methods in summaries[by].items()
            for method, score in methods.items()
        ]
        made[by] = TextTable(_HEADINGS, rows, texts=2)
    return made


def _cells(score: PoseSummary) -> list[str]:
    def shown(one: Interval | None, digits: int, factor: float = 1.0) -> str:
        """A number that a group may lack and, where there are several tracks, its 95 % interval."""
        if one is None:
            return "-"
        return f"{factor * one.value:.{digits}f}" if score.tracks < 2 else one.shown(digits, factor)

    found = [
        *(shown(share, 1) for share in score.aop.values()),
        shown(score.heading_flips, 2),
        shown(score.silent, 2),
        "-" if score.network_heading_flips is None else f"{score.network_heading_flips.value:.1f}",
        f"{score.mean_degrees.value:.2f}",
        shown(score.intervals.get("median_metres"), 3),
        shown(score.intervals.get("mean_metres"), 3),
        shown(score.overlapping, 1),
        shown(score.intervals.get("mean_absolute_length_error"), 1, 100.0),
        shown(score.intervals.get("mean_absolute_size_error"), 1, 100.0),
        number_or_dash(score.jitter_degrees, ".2f"),
        number_or_dash(score.jitter_metres, ".3f"),
    ]
    for name in DIMENSIONS:
        one = score.consistency.get(name)
        found.append(
            "-" if one is None else f"{one.mean:.1f} / {one.median:.2f} / {one.within:.0f} % / {one.inside:.0f} %"
        )
    return [*found, shown(score.intervals.get("median_velocity"), 2), str(score.refused)]
