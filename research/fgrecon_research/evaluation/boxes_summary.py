"""Summary of 3D boxes against labels: overlaps, errors and average precision, by kind and distance.

Intervals are by bootstrap over tracks, or images of a folder of single ones. Average precision is the official one
(`evaluation.kitti_devkit`), over all boxes of cars that a source gives; labels that something is drawn over may
be found or missed. Its curve has as many points as there are labels at most, up to 41: of fewer the best possible
number is below 100 (12.5 of 6), and there is none.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgrecon.calibration.labelled_boxes import FLIPPED_DEGREES
from fgrecon.core.serialise import finite
from fgrecon.io.kitti_files import Drive, DriveFrame, Objects
from fgrecon_research.evaluation.bootstrap import Interval, mean_interval, median_interval, shown
from fgrecon_research.evaluation.boxes3d import LabelledBox
from fgrecon_research.evaluation.kitti_devkit import LEAST_LABELS, REGIMES, Space, evaluate
from fgrecon_research.evaluation.measures import THRESHOLDS, bands
from fgrecon_research.evaluation.text_table import TextTable, number_or_dash

LEAST_OVERLAPS = (0.5, 0.7)
"""Overlaps from which on a box counts as right."""

DISTANCES = (0.0, 15.0, 30.0, np.inf)  # metres
_UNKNOWN = 3  # KITTI's grade of occlusion


@dataclass(frozen=True)
class OverlapSummary:
    """A group of vehicles; shares in percent of all of them, found or not, errors over the found ones."""

    vehicles: int  # how many there are
    tracks: int  # of how many tracks, or images where they are single
    found: int  # how many got a box
    right: tuple[Interval, ...]  # share with a 3D overlap of at least each of `LEAST_OVERLAPS`
    ground: tuple[Interval, ...]  # share with such an overlap from above
    within: tuple[Interval, ...]  # share within 5, 15 and 30 degrees
    flipped: float  # share of the found ones with a heading flip: off by more than 90 degrees
    mean_metres: Interval | None  # mean distance of the origins; None where none is found
    median_metres: float  # the median
    depth: float  # median relative error of the depth, percent
    size: tuple[float, float, float]  # mean errors of length, width and height, metres
    # of `median_metres`, `depth`, `length`, `width` and `height` as above, and of `absolute_size`, the mean of the
    # errors of length, width and height without sign, metres; empty where none is found
    intervals: Mapping[str, Interval]


@dataclass(frozen=True)
class Precision:
    """Average precision at 40 recall points, percent; None of fewer than 41 labels."""

    regime: str  # `Easy`, `Moderate` or `Hard`
    labels: int  # number of cars that count
    image: float | None  # of 2D boxes at an overlap of 0.7
    orientation: float | None  # average orientation similarity (AOS); None where the source has no angles
    ground: tuple[float | None, ...]  # from above, at each of `LEAST_OVERLAPS`
    volume: tuple[float | None, ...]  # in 3D, likewise


def summarise(vehicles: Sequence[LabelledBox]) -> dict[str, OverlapSummary]:
    """Summaries of each kind, of all where there are vans, and of cars by distance; groups without any are left out."""
    cars, vans = ([one for one in vehicles if one.kind == kind] for kind in ("Car", "Van"))
    groups = {"cars": cars, "vans": vans, "all": list(vehicles) if vans else []} | by_distance("cars", cars)
    return {name: summarise_group(members) for name, members in groups.items() if members}


def by_distance(name: str, vehicles: Sequence[LabelledBox]) -> dict[str, list[LabelledBox]]:
    """Vehicles by the distance of their labels, under a name and the metres."""
    by_metres = bands(vehicles, DISTANCES, lambda one: one.distance, "m", "beyond {}")
    return {f"{name} {metres}": members for metres, members in by_metres.items()}


def summarise_group(vehicles: Sequence[LabelledBox]) -> OverlapSummary:
    """Summary of a group.

    Raises:
        InvalidInputError: There is no vehicle.
    """
    groups = np.unique([f"{one.drive}/{one.group}" for one in vehicles], return_inverse=True)[1]
    got = np.array([one.found for one in vehicles], dtype=bool)

    def errors(name: str) -> NDArray[np.float64]:
        return np.array([getattr(one, name) for one in vehicles if one.found])

    def share(members: NDArray[np.bool_]) -> Interval:
        return mean_interval(100.0 * members, groups)

    def shares(name: str) -> tuple[Interval, ...]:
        overlaps = np.array([getattr(one, name) for one in vehicles])
        return tuple(share(overlaps >= least) for least in LEAST_OVERLAPS)

    degrees = np.array([one.degrees for one in vehicles])
    metres, sizes, own = errors("metres"), errors("size").reshape(-1, 3), groups[got]
    intervals = {}
    if got.any():
        intervals = {
            "median_metres": median_interval(metres, own),
            "depth": median_interval(100.0 * errors("depth"), own),
            **{name: mean_interval(sizes[:, i], own) for i, name in enumerate(("length", "width", "height"))},
            "absolute_size": mean_interval(np.abs(sizes).mean(axis=1), own),
        }
    values = {name: one.value for name, one in intervals.items()}
    return OverlapSummary(
        vehicles=len(vehicles),
        tracks=int(groups.max()) + 1,
        found=int(got.sum()),
        right=shares("overlap"),
        ground=shares("footprint"),
        within=tuple(share(degrees <= most) for most in THRESHOLDS),
        flipped=100.0 * float((degrees[got] > FLIPPED_DEGREES).mean()) if got.any() else np.nan,
        mean_metres=mean_interval(metres, own) if got.any() else None,
        median_metres=values.get("median_metres", np.nan),
        depth=values.get("depth", np.nan),
        size=(values.get("length", np.nan), values.get("width", np.nan), values.get("height", np.nan)),
        intervals=intervals,
    )


def precisions(labels: Mapping[str, Objects], results: Mapping[str, Objects]) -> list[Precision]:
    """KITTI's average precision of cars in each regime."""
    image = evaluate(labels, results)
    ground, volume = (
        [evaluate(labels, results, space=space, minimum_overlap=least) for least in LEAST_OVERLAPS]
        for space in (Space.GROUND, Space.VOLUME)
    )
    found = []
    for i, regime in enumerate(REGIMES):
        enough, similarity = image[i].labels >= LEAST_LABELS, image[i].orientation_similarity
        found.append(
            Precision(
                regime.name,
                image[i].labels,
                image[i].average_precision[1] if enough else None,
                similarity[1] if enough and similarity is not None else None,
                tuple(curves[i].average_precision[1] if enough else None for curves in ground),
                tuple(curves[i].average_precision[1] if enough else None for curves in volume),
            )
        )
    return found


def precisions_of_drives(
    drives: Sequence[Drive], results: Mapping[str, Mapping[int, Objects]], frames: Mapping[str, Sequence[int]]
) -> list[Precision]:
    """`precisions` over frames of drives; results and frames are by their names."""
    labels, boxes = {}, {}
    for drive in drives:
        chosen = set(frames[drive.name])
        for frame in drive.frames:
            if frame.number in chosen:
                name = f"{drive.name}/{frame.number}"
                labels[name], boxes[name] = _counting(frame), results[drive.name][frame.number]
    return precisions(labels, boxes)


def document(scored: Mapping[str, Sequence[LabelledBox]], curves: Mapping[str, Sequence[Precision]]) -> dict[str, Any]:
    """Plain values for JSON, of several sources."""
    return {
        "format": "fgrecon.boxes/1",
        "least_overlaps": list(LEAST_OVERLAPS),
        "sources": [
            {"name": name} | plain_boxes(summarise(vehicles), curves[name], vehicles)
            for name, vehicles in scored.items()
        ],
    }


def plain_boxes(
    groups: Mapping[str, OverlapSummary], curves: Sequence[Precision], vehicles: Sequence[LabelledBox]
) -> dict[str, Any]:
    """Plain values of one source: groups by name, average precision by regime, and every vehicle."""
    return {
        "groups": {group: finite(asdict(summary)) for group, summary in groups.items()},
        "average_precision_40": [asdict(one) for one in curves],
        "vehicles": [finite(asdict(one)) for one in vehicles],
    }


def _counting(frame: DriveFrame) -> Objects:
    """The labels; those that something is drawn over as KITTI's of unknown occlusion, which no regime counts."""
    return replace(frame.objects, occlusion=np.where(frame.usable, frame.objects.occlusion, _UNKNOWN))


def tables(
    summaries: Mapping[str, Mapping[str, OverlapSummary]], curves: Mapping[str, Sequence[Precision]]
) -> tuple[TextTable, TextTable, TextTable]:
    """Overlaps and angles, errors of the found vehicles, and average precision."""
    spaces = [f"{space} IoU ≥ {least:g} %" for space in ("3D", "BEV") for least in LEAST_OVERLAPS]
    shares: list[dict[str, str]] = []
    errors: list[dict[str, str]] = []
    for group in dict.fromkeys(group for groups in summaries.values() for group in groups):
        for name, groups in summaries.items():
            one = groups[group]
            about = {"": group, "source": name}
            intervals = [shown(share, one.tracks, 0) for share in (*one.right, *one.ground, *one.within)]
            heads = (*spaces, *(f"within {most}° %" for most in THRESHOLDS))
            counts = {"labels": str(one.vehicles), "found": str(one.found)}
            shares.append(about | counts | dict(zip(heads, intervals, strict=True)))
            errors.append(about | _error_cells(one))
    places = [f"{space} {least:g}" for space in ("BEV", "3D") for least in LEAST_OVERLAPS]
    precision = [
        {"AP at 40 points": f"cars, {one.regime}", "source": name, "labels": str(one.labels)}
        | {"2D 0.7": number_or_dash(one.image, ".1f"), "AOS": number_or_dash(one.orientation, ".1f")}
        | {p: number_or_dash(value, ".1f") for p, value in zip(places, (*one.ground, *one.volume), strict=True)}
        for regimes in zip(*curves.values(), strict=True)
        for name, one in zip(curves, regimes, strict=True)
    ]
    return TextTable.of(shares, texts=2), TextTable.of(errors, texts=2), TextTable.of(precision, texts=2)


def _error_cells(one: OverlapSummary) -> dict[str, str]:
    known, of, tracks = one.intervals, one.found, one.tracks
    return {
        "mean m": shown(one.mean_metres, tracks, 2),
        "median m": shown(known.get("median_metres"), tracks, 2),
        "depth %": f"{one.depth:+.1f}" if of else "-",
        "flipped %": f"{one.flipped:.1f}" if of else "-",
        "size cm": shown(known.get("absolute_size"), tracks, 0, 100.0),
        "l, w, h m": ", ".join(f"{error:+.2f}" for error in one.size) if of else "-",
    }
