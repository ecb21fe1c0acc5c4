"""Summary of the boxes of video drives: by drive, by visibility of the vehicle, and with intervals.

Boxes of one track show one vehicle and go wrong together, so the intervals draw whole tracks (bootstrap).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from typing import Any

import numpy as np
from scipy.stats import chi2

from fgrecon.calibration.labelled_boxes import (
    DIMENSIONS,
    FLIPPED_DEGREES,
    MINIMUM_OVERLAP,
    SYSTEM,
    BoxOutcome,
    VideoBox,
    View,
)
from fgrecon.core.arrays import Array
from fgrecon.core.coverage import Reliability, reliability
from fgrecon.core.metrics import wrap_angle
from fgrecon.core.reconstruction import Status
from fgrecon.core.serialise import finite
from fgrecon.io.kitti_files import Objects
from fgrecon_research.evaluation.bootstrap import Interval, mean_interval, median_interval, shown
from fgrecon_research.evaluation.kitti_devkit import Space, overlap
from fgrecon_research.evaluation.measures import THRESHOLDS, bands
from fgrecon_research.evaluation.text_table import TextTable, number_or_dash

# Whether estimates are as sure as they say: squared errors by their own covariances (NEES).
#
# The normalised estimation error squared of an estimate whose covariance is right is a chi-square variable; divided by
# its dimension its mean is 1. Errors of one track go together, so the bounds about 1 are those of as many draws as
# there are tracks: a mean above them says that covariances are too small, one below that they are too large.


_SHARE, _INNER = 0.95, 0.68


@dataclass(frozen=True)
class Consistency:
    """How squared errors compare with their covariances."""

    mean: float  # of the normalised squared errors, by dimension; 1 where covariances are right
    low: float  # between which it is, 95 times of 100, where they are right
    high: float
    median: float  # the median over that of the chi-square distribution; 1 where covariances are right
    inside: float  # percent of the errors within their 95 % region
    within: float  # percent of the errors within their 68 % region
    count: int  # number of estimates


def consistency(errors: Sequence[float], dimension: int, tracks: int) -> Consistency | None:
    """Compare normalised squared errors with what right covariances make of them; None without an error."""
    if not len(errors):
        return None
    low, high = (float(chi2.ppf(p, dimension * tracks)) / (dimension * tracks) for p in (0.025, 0.975))
    return Consistency(
        mean=float(np.mean(errors)) / dimension,
        low=low,
        high=high,
        median=float(np.median(errors) / chi2.ppf(0.5, dimension)),
        inside=100.0 * float(np.mean(np.array(errors) <= chi2.ppf(_SHARE, dimension))),
        within=100.0 * float(np.mean(np.array(errors) <= chi2.ppf(_INNER, dimension))),
        count=len(errors),
    )


FORMAT = "fgrecon.video-images/1"
_NEXT = 2  # frames: labelled boxes are in every second one at least
_SIZES = (25.0, 40.0, 60.0, 120.0, np.inf)  # pixels of the box's height
_ON = "from {} on"
_DISTANCES = (0.0, 10.0, 20.0, 30.0, 50.0, np.inf)  # metres
_POINTS = (0.0, 5.0, 20.0, 100.0, 500.0, np.inf)  # of a LiDAR in the labelled box
_OVERLAPPING = MINIMUM_OVERLAP["Car"]  # in 3D, from which on KITTI takes a box for a car's
_OCCLUSIONS = {0: "fully visible", 1: "partly occluded", 2: "largely occluded"}
_UNITS = {
    "mean_degrees": "degrees of yaw error on the full circle; a refused box counts 180",
    "aop": "percent of all boxes with a yaw error of at most 5, 15 and 30 degrees",
    "heading_flips": "percent of all boxes with a pose whose yaw error is above 90 degrees",
    "without_estimate": "percent of all boxes without a pose: no heading flips",
    "silent": "percent of all boxes with a heading flip that have the status converged; null for a rival",
    "network_heading_flips": "percent of all boxes where the directions within 90 degrees of the labelled one have at "
    "most half of the network's probability; null where it gives no directions",
    "median_metres": "between estimated and labelled origin, over the boxes with a pose",
    "mean_metres": "the same",
    "mean_size_error": "metres, estimated minus labelled length, width and height, over the boxes with a pose",
    "overlapping": "percent of all boxes whose estimated 3D box shares at least 0.7 of the union with the labelled "
    "one; null for methods without 3D boxes",
    "mean_absolute_length_error": "metres, mean of the absolute error of the length, over the boxes with a pose",
    "mean_absolute_size_error": "metres, mean of the absolute errors of length, width and height",
    "jitter_degrees": "mean change of the yaw error from a box to the next one of its track, at most two frames later; "
    "null where no yaw errors are known",
    "jitter_metres": "the same of the position error, a vector",
    "median_velocity": "metres per second over the ground, estimated minus labelled; labels within 0.2 s make a line, "
    "and are carried into the world by the camera's estimated motion where that is known",
    "consistency": "normalised squared errors by dimension (NEES): mean, its 95 % bounds for as many draws as tracks, "
    "median over that of the chi-square distribution, percent within the 95 % and the 68 % region; without heading "
    "flips",
    "intervals": "of the numbers of the same names",
    "interval": "95 % by bootstrap over tracks; null where there is one track",
    "facing": "probability of the directions within 90 degrees of the labelled one; the bins, of equally many boxes, "
    "compare the probability of the more probable half, this one or the other, with how often it is the labelled one",
}


_MEASURES = {
    "median_metres": median_interval,
    "mean_metres": mean_interval,
    "mean_absolute_size_error": mean_interval,
    "mean_absolute_length_error": mean_interval,
    "median_velocity": median_interval,
}


@dataclass(frozen=True)
class PoseSummary:
    """One method on a group of boxes; `_UNITS` says what the numbers are. NaN, or None, where nothing is known."""

    boxes: int  # number of boxes
    tracks: int  # number of tracks that they are of
    mean_degrees: Interval
    aop: Mapping[int, Interval]  # by degrees
    heading_flips: Interval
    without_estimate: Interval
    silent: Interval | None
    network_heading_flips: Interval | None
    mean_size_error: tuple[float, float, float] | None
    refused: int  # number of boxes without a pose
    jitter_degrees: float | None
    jitter_metres: float | None
    overlapping: Interval | None
    consistency: Mapping[str, Consistency]  # of what has covariances, by its name (`DIMENSIONS`)
    intervals: Mapping[str, Interval]  # of position, size and velocity (`_MEASURES`), where they are known


Summaries = Mapping[str, Mapping[str, Mapping[str, PoseSummary]]]
"""By what the groups are formed by, by their names, and by method."""


def methods_of(boxes: Sequence[VideoBox]) -> tuple[str, ...]:
    """Names of the methods that ran on the boxes."""
    return tuple(boxes[0].outcomes) if boxes else ()


def group_boxes(boxes: Sequence[VideoBox]) -> dict[str, dict[str, list[VideoBox]]]:
    """The groups that have a box, by what they are formed by and by their names; regimes are cumulative.

    `cars_easy` are cars that are fully visible and at least 40 px high, `cars_moderate` those occluded partly at most.
    """
    pointed, cars = [one for one in boxes if one.points is not None], [b for b in boxes if b.kind == "Car"]
    groups: dict[str, dict[str, list[VideoBox]]] = {
        "drive": {name: [b for b in boxes if b.drive == name] for name in dict.fromkeys(b.drive for b in boxes)},
        "regime": {
            "cars_easy": [b for b in cars if b.occlusion <= 0 and b.height >= 40.0],
            "cars_moderate": [b for b in cars if b.occlusion <= 1],
            "cars": cars,
            "vans": [b for b in boxes if b.kind == "Van"],
            "all": list(boxes),
        },
        "view": {view.value: [b for b in boxes if b.view is view] for view in View},
        "height": bands(boxes, _SIZES, lambda b: b.height, "px", _ON),
        "occlusion": {name: [b for b in boxes if b.occlusion == level] for level, name in _OCCLUSIONS.items()}
        | {"unknown": [b for b in boxes if b.occlusion not in _OCCLUSIONS]},
        "distance": bands(boxes, _DISTANCES, lambda b: b.distance, "m", _ON),
        "points": bands(pointed, _POINTS, lambda b: float(b.points or 0), "points", _ON),
    }
    filled = {by: {name: some for name, some in named.items() if some} for by, named in groups.items()}
    return {by: named for by, named in filled.items() if named}


def summarise_boxes(boxes: Sequence[VideoBox], method: str) -> PoseSummary:
    """One method's numbers on a group of boxes.

    Raises:
        InvalidInputError: There is no box.
    """
    found = [box.outcomes[method] for box in boxes]
    names = [(box.drive, box.track) for box in boxes]
    numbers = {name: number for number, name in enumerate(dict.fromkeys(names))}
    tracks = np.array([numbers[name] for name in names])

    def share(members: Sequence[bool]) -> Interval:
        return mean_interval(100.0 * np.array(members, dtype=np.float64), tracks)

    flips = [one.failure is None and one.degrees > FLIPPED_DEGREES for one in found]
    silent = [off and one.status == Status.CONVERGED.value for off, one in zip(flips, found, strict=True)]
    metres = np.array([one.metres for one in found])
    sizes = [one.size for one in found if one.size is not None]
    absolute = np.array([np.nan if one.size is None else float(np.mean(np.abs(one.size))) for one in found])
    length, width, height = np.mean(sizes, axis=0).tolist() if sizes else (np.nan,) * 3
    facing = [box.facing for box in boxes if box.facing is not None]
    lengths = np.array([np.nan if one.size is None else abs(one.size[0]) for one in found])
    overlaps = [box_overlap(box, one) for box, one in zip(boxes, found, strict=True)]
    known_overlaps = [value for value in overlaps if value is not None]
    velocities = np.array([np.nan if one.velocity is None else one.velocity for one in found])
    intervals = {
        name: interval(errors[known], tracks[known])
        for (name, interval), errors in zip(
            _MEASURES.items(), (metres, metres, absolute, lengths, velocities), strict=True
        )
        if (known := np.isfinite(errors)).any()
    }
    return PoseSummary(
        boxes=len(boxes),
        tracks=len(numbers),
        mean_degrees=mean_interval([one.degrees for one in found], tracks),
        aop={threshold: share([one.degrees <= threshold for one in found]) for threshold in THRESHOLDS},
        heading_flips=share(flips),
        without_estimate=share([one.failure is not None for one in found]),
        silent=share(silent) if method == SYSTEM else None,
        network_heading_flips=share([value <= 0.5 for value in facing]) if len(facing) == len(boxes) else None,
        mean_size_error=(length, width, height) if sizes else None,
        refused=sum(one.failure is not None for one in found),
        overlapping=share([(value or 0.0) >= _OVERLAPPING for value in overlaps]) if known_overlaps else None,
        **_jitter(boxes, method),
        consistency=_consistency(boxes, method),
        intervals=intervals,
    )


def box_overlap(box: VideoBox, found: BoxOutcome) -> float | None:
    """Share of their union that the estimated and the labelled 3D box have in common; None where one is not known."""
    if box.size is None or found.size is None or found.off is None:
        return None
    turned, *place = found.off
    estimated = np.add(box.size, found.size)
    both = _cuboid(np.zeros(3), 0.0, box, box.size), _cuboid(np.array(place), np.radians(turned), box, estimated)
    return float(overlap(Space.VOLUME, *both)[0, 0])


def _cuboid(place: Array, turned: float, box: VideoBox, size: Sequence[float] | Array) -> Objects:
    """A 3D box at a place (3,) and yaw from the labelled one's."""
    length, width, height = size
    return Objects.of_rows([box.kind], np.array([*7 * [0.0], height, width, length, *place, box.rotation_y + turned]))


def _consistency(boxes: Sequence[VideoBox], method: str) -> dict[str, Consistency]:
    found = {}
    for name, dimension in DIMENSIONS.items():
        pairs = [(box.outcomes[method].squared.get(name), (box.drive, box.track)) for box in boxes]
        errors = [error for error, _ in pairs if error is not None]
        tracks = {track for error, track in pairs if error is not None}
        one = consistency(errors, dimension, len(tracks))
        if one is not None:
            found[name] = one
    return found


def _jitter(boxes: Sequence[VideoBox], method: str) -> dict[str, float | None]:
    """How much errors change from a box to the next one of its track."""
    last: dict[tuple[str, int], tuple[int, tuple[float, ...]]] = {}
    turns, ways = [], []
    for box in boxes:
        off, name = box.outcomes[method].off, (box.drive, box.track)
        if off is None:
            continue
        frame, before = last.get(name, (-np.inf, off))
        if box.frame - frame <= _NEXT:
            turns.append(abs(float(wrap_angle(np.radians(off[0] - before[0])))))
            ways.append(float(np.linalg.norm(np.subtract(off[1:], before[1:]))))
        last[name] = box.frame, off
    if not turns:
        return {"jitter_degrees": None, "jitter_metres": None}
    return {"jitter_degrees": float(np.degrees(np.mean(turns))), "jitter_metres": float(np.mean(ways))}


def facing_reliability(boxes: Sequence[VideoBox]) -> Reliability:
    """How often the half of all directions that the network finds more probable is the right one.

    The halves are the directions within 90 degrees of the labelled one, and the others. Boxes for which the network
    gives no directions are left out.
    """
    facing = np.array([box.facing for box in boxes if box.facing is not None], dtype=np.float64)
    return reliability(np.maximum(facing, 1.0 - facing), facing > 0.5)


def worst_boxes(boxes: Sequence[VideoBox], count: int) -> list[VideoBox]:
    """The worst box with a pose of each of the tracks that are worst by it: by yaw error, then by position error."""
    posed = [(b, b.outcomes[SYSTEM]) for b in boxes if b.outcomes[SYSTEM].failure is None]
    tracks: dict[tuple[str, int], VideoBox] = {}
    for box, _ in sorted(posed, key=lambda one: (one[1].degrees, one[1].metres), reverse=True):
        tracks.setdefault((box.drive, box.track), box)
    return list(tracks.values())[:count]


def summarise_groups(boxes: Sequence[VideoBox]) -> Summaries:
    """The numbers of every group of `group_boxes` by every method."""
    methods = methods_of(boxes)
    return {
        by: {name: {method: summarise_boxes(some, method) for method in methods} for name, some in named.items()}
        for by, named in group_boxes(boxes).items()
    }


def document(
    boxes: Sequence[VideoBox], summaries: Summaries, given: Mapping[str, Any], networks: Sequence[Mapping[str, Any]]
) -> dict[str, Any]:
    """Everything as plain values for JSON.

    Args:
        networks: Of each network its file, the drives that it scored, and what it has learnt from.
    """
    facing = facing_reliability(boxes)
    return {
        "format": FORMAT,
        "given": dict(given),
        "networks": [dict(network) for network in networks],
        "units": _UNITS,
        "methods": {
            method: {
                by: {name: _plain(scores[method]) for name, scores in named.items()} for by, named in summaries.items()
            }
            for method in methods_of(boxes)
        },
        "facing": {
            "expected_calibration_error": facing.error,
            "bins": [
                {"boxes": int(count), "probability": float(sure), "right": float(right)}
                for count, sure, right in zip(facing.count, facing.confidence, facing.right, strict=True)
            ],
        },
        "boxes": [row for box in boxes for row in box.rows()],
    }


def _plain(summary: PoseSummary) -> dict[str, Any]:
    """By the names of its numbers; of a single track nothing can be drawn, so that its intervals would look certain."""

    def plain(value: Any) -> Any:
        if isinstance(value, Interval):
            return asdict(value) if summary.tracks > 1 else {"value": value.value, "low": None, "high": None}
        if isinstance(value, Mapping):
            return {str(name): plain(one) for name, one in value.items()}
        return asdict(value) if isinstance(value, Consistency) else finite(value)

    values = {name: summary.intervals[name].value if name in summary.intervals else None for name in _MEASURES}
    return {entry.name: plain(getattr(summary, entry.name)) for entry in fields(summary)} | values


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
            {"boxes": f"{name}, {score.boxes}", "method": method} | _cells(score)
            for name, methods in summaries[by].items()
            for method, score in methods.items()
        ]
        made[by] = TextTable.of(rows, texts=2)
    return made


def _cells(score: PoseSummary) -> dict[str, str]:
    """The numbers by their headings."""
    network, known, tracks = score.network_heading_flips, score.intervals, score.tracks
    return {
        **{f"AOP {threshold}° %": shown(share, tracks, 1) for threshold, share in score.aop.items()},
        "flipped %": shown(score.heading_flips, tracks, 2),
        "no estimate %": shown(score.without_estimate, tracks, 2),
        "silent %": shown(score.silent, tracks, 2),
        "network %": "-" if network is None else f"{network.value:.1f}",
        "yaw °": f"{score.mean_degrees.value:.2f}",
        "median m": shown(known.get("median_metres"), tracks, 3),
        "mean m": shown(known.get("mean_metres"), tracks, 3),
        "IoU 0.7 %": shown(score.overlapping, tracks, 1),
        "length cm": shown(known.get("mean_absolute_length_error"), tracks, 1, 100.0),
        "size cm": shown(known.get("mean_absolute_size_error"), tracks, 1, 100.0),
        "jitter °": number_or_dash(score.jitter_degrees, ".2f"),
        "jitter m": number_or_dash(score.jitter_metres, ".3f"),
        **{f"{name} NEES": _compared(score.consistency.get(name)) for name in DIMENSIONS},
        "velocity m/s": shown(known.get("median_velocity"), tracks, 2),
    }


def _compared(one: Consistency | None) -> str:
    if one is None:
        return "-"
    return f"{one.mean:.1f} / {one.median:.2f} / {one.within:.0f} % / {one.inside:.0f} %"
