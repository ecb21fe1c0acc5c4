"""3D boxes of any source against KITTI's labels, several sources side by side: what each labelled vehicle got.

Vehicles count as in `fgrecon.evaluation.video_images` (`wanted`): cars and vans of at least 25 px. Each gets the box of
a car, or else of a van, that overlaps it most in the image and is no other's; one without any counts in every share.
Average precision is the official one (`fgrecon.evaluation.kitti_devkit`), over all boxes of cars that a source gives;
labels that something is drawn over may be found or missed. Intervals are by bootstrap over tracks, or images of a
folder of single ones.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.errors import InvalidInputError
from fgrecon.core.metrics import FAILURE_DEGREES, THRESHOLDS, orientation_error
from fgrecon.core.plain import finite
from fgrecon.evaluation.bootstrap import Interval, mean_interval
from fgrecon.evaluation.kitti_devkit import REGIMES, evaluate
from fgrecon.evaluation.kitti_overlap import Space, overlap
from fgrecon.evaluation.video_images import TURNED_ROUND, matched, wanted
from fgrecon.io.kitti_drives import Drive, DriveFrame
from fgrecon.io.kitti_files import LABEL_COLUMNS, Defect, Objects, parse_objects

__all__ = [
    "LEAST_OVERLAPS",
    "BoxesSummary",
    "LabelledBox",
    "Precision",
    "document",
    "precisions",
    "read_boxes",
    "score",
    "summarise",
]

Array = NDArray[np.float64]

LEAST_OVERLAPS = (0.5, 0.7)
"""3D overlaps from which on a box counts as right."""

_DISTANCES = (0.0, 15.0, 30.0, np.inf)  # metres
_NAME = "{:06d}"  # of a frame
_UNKNOWN = 3  # KITTI's grade of occlusion


@dataclass(frozen=True)
class LabelledBox:
    """One labelled vehicle, and the box that a source has for it.

    Attributes:
        frame: Name of the frame.
        index: Position among the frame's labels.
        kind: `Car` or `Van`.
        distance: Of the labelled origin, metres.
        group: What errs alike: its track in a drive, its image among single ones.
        found: Whether there is a box.
        overlap: Intersection over union in 3D, and
        footprint: from above; 0 without a box.
        metres: Distance of the origins; infinite without a box.
        depth: Relative error of the depth; NaN without a box.
        degrees: Yaw error on the full circle; 180 without a box.
        size: (3,) length, width and height, estimated minus labelled, metres; NaN without a box.
    """

    frame: str
    index: int
    kind: str
    distance: float
    group: str
    found: bool
    overlap: float
    footprint: float
    metres: float
    depth: float
    degrees: float
    size: tuple[float, float, float]


@dataclass(frozen=True)
class BoxesSummary:
    """A group of vehicles; shares in percent of all of them, found or not.

    Attributes:
        vehicles: How many there are.
        found: How many got a box.
        right: Share with a 3D overlap of at least each of `LEAST_OVERLAPS`.
        within: Share within 5, 15 and 30 degrees.
        turned: Share of the found ones that is turned by more than 90 degrees.
        mean_metres: Mean distance of the origins over the found ones.
        median_metres: The median.
        depth: Median relative error of the depth, percent.
        size: Mean errors of length, width and height, metres.
    """

    vehicles: int
    found: int
    right: tuple[Interval, ...]
    within: tuple[Interval, ...]
    turned: float
    mean_metres: Interval | None
    median_metres: float
    depth: float
    size: tuple[float, float, float]


@dataclass(frozen=True)
class Precision:
    """Average precision at 40 recall points, percent.

    Attributes:
        regime: `Easy`, `Moderate` or `Hard`.
        labels: Number of cars that count.
        image: Of 2D boxes at an overlap of 0.7.
        orientation: Average orientation similarity (AOS), where the source has angles.
        ground: From above, at each of `LEAST_OVERLAPS`.
        volume: In 3D, likewise.
    """

    regime: str
    labels: int
    image: float
    orientation: float | None
    ground: tuple[float, ...]
    volume: tuple[float, ...]


def read_boxes(path: Path, frames: Sequence[int]) -> dict[int, Objects]:
    """Boxes by frame, of those frames that the source speaks of.

    Args:
        path: Folder with a file of KITTI's object lines a frame, named by its number, or one file of KITTI's tracking
            lines, which speaks of every frame. A line without a score has the score 1.
        frames: Numbers of the frames.

    Raises:
        InvalidInputError: It cannot be read, or a line is malformed; names file and line.
    """
    if path.is_dir():
        files = {number: path / f"{_NAME.format(number)}.txt" for number in frames}
        texts = {number: _text(file) for number, file in files.items() if file.is_file()}
        if not texts:
            fix = f"Give a folder with files {_NAME.format(frames[0])}.txt, or a file of tracking lines."
            raise InvalidInputError("results", str(path), fix)
        return {number: _objects(text, str(files[number])) for number, text in texts.items()}
    lines: dict[int, list[str]] = defaultdict(list)
    for at, line in enumerate(_text(path).splitlines(), start=1):
        if not line.strip():
            continue
        try:
            frame, _, rest = line.split(maxsplit=2)
            lines[int(frame)].append(rest)
        except ValueError as error:
            fix = "Give lines of frame, track and an object label."
            raise InvalidInputError(f"{path}:{at}", line[:80], fix) from error
    return {number: _objects("\n".join(lines[number]), f"{path}, frame {number}") for number in frames}


def score(
    drive: Drive, results: Mapping[int, Objects], frames: Sequence[int], *, least: float = 0.5, min_score: float = 0.0
) -> list[LabelledBox]:
    """What each labelled vehicle that counts got.

    Args:
        drive: The labels.
        results: Boxes by frame.
        frames: Numbers of the frames to score.
        least: Overlap in the image above which a box is a vehicle's.
        min_score: Boxes of a lower score are none.
    """
    chosen = set(frames)
    is_video = len(np.unique(np.concatenate([frame.tracks for frame in drive.frames]))) < sum(
        len(frame.tracks) for frame in drive.frames
    )
    found: list[LabelledBox] = []
    for frame in drive.frames:
        if frame.number not in chosen:
            continue
        rows = wanted(frame)
        labels, boxes = frame.objects.take(rows), results[frame.number]
        boxes = boxes.take(boxes.score >= min_score)
        at = matched(frame, boxes, least)
        for i, (row, j) in enumerate(zip(rows.tolist(), at.tolist(), strict=True)):
            label, name = labels.take(np.array([i])), _NAME.format(frame.number)
            group = str(frame.tracks[row]) if is_video else name
            found.append(_scored(name, row, group, label, None if j < 0 else boxes.take(np.array([j]))))
    return found


def summarise(vehicles: Sequence[LabelledBox]) -> dict[str, BoxesSummary]:
    """Summaries of all vehicles, of each kind, and of cars by distance; groups without any are left out."""
    cars = [one for one in vehicles if one.kind == "Car"]
    groups = {"cars": cars, "vans": [one for one in vehicles if one.kind == "Van"]}
    for low, high in pairwise(_DISTANCES):
        name = f"cars {low:.0f}-{high:.0f} m" if np.isfinite(high) else f"cars beyond {low:.0f} m"
        groups[name] = [one for one in cars if low <= one.distance < high]
    return {name: _summary(members) for name, members in groups.items() if members}


def precisions(drive: Drive, results: Mapping[int, Objects], frames: Sequence[int]) -> list[Precision]:
    """KITTI's average precision of cars in each regime, over the frames."""
    labels = {str(frame.number): _counting(frame) for frame in drive.frames if frame.number in set(frames)}
    boxes = {name: results[int(name)] for name in labels}
    image = evaluate(labels, boxes)
    spaces = {
        space: [evaluate(labels, boxes, space=space, minimum_overlap=least) for least in LEAST_OVERLAPS]
        for space in (Space.GROUND, Space.VOLUME)
    }
    told = []
    for i, regime in enumerate(REGIMES):
        similarity = image[i].orientation_similarity
        ground, volume = (tuple(curves[i].average_precision[1] for curves in spaces[space]) for space in spaces)
        told.append(
            Precision(
                regime.name,
                image[i].labels,
                image[i].average_precision[1],
                None if similarity is None else similarity[1],
                ground,
                volume,
            )
        )
    return told


def document(scored: Mapping[str, Sequence[LabelledBox]], curves: Mapping[str, Sequence[Precision]]) -> dict[str, Any]:
    """Plain values for JSON."""
    return {
        "format": "fgrecon.boxes/1",
        "least_overlaps": list(LEAST_OVERLAPS),
        "sources": [
            {
                "name": name,
                "groups": {group: _plain(summary) for group, summary in summarise(vehicles).items()},
                "average_precision_40": [vars(one) for one in curves[name]],
                "vehicles": [finite(vars(one)) for one in vehicles],
            }
            for name, vehicles in scored.items()
        ],
    }


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise InvalidInputError("results", str(path), f"Give a text file that can be read ({error}).") from error


def _objects(text: str, place: str) -> Objects:
    """Lines of labels or results; labels have the score 1."""
    scored = [line if len(line.split()) != LABEL_COLUMNS else f"{line} 1" for line in text.splitlines()]
    objects, faults = parse_objects("\n".join(scored), place, scored=True)
    faults = [fault for fault in faults if fault.defect is Defect.MALFORMED_LINE]
    if faults:
        raise InvalidInputError(faults[0].place, str(faults[0]), "Give lines of KITTI's object results.")
    return objects


def _counting(frame: DriveFrame) -> Objects:
    """The labels; those that something is drawn over as KITTI's of unknown occlusion, which no regime counts."""
    return replace(frame.objects, occlusion=np.where(frame.usable, frame.objects.occlusion, _UNKNOWN))


def _scored(frame: str, index: int, group: str, label: Objects, box: Objects | None) -> LabelledBox:
    about = (frame, index, label.kind[0], float(np.linalg.norm(label.location[0])), group, box is not None)
    if box is None:
        return LabelledBox(*about, 0.0, 0.0, np.inf, np.nan, FAILURE_DEGREES, (np.nan, np.nan, np.nan))
    length, width, height = (box.size[0] - label.size[0]).tolist()
    return LabelledBox(
        *about,
        float(overlap(Space.VOLUME, label, box)[0, 0]),
        float(overlap(Space.GROUND, label, box)[0, 0]),
        float(np.linalg.norm(box.location[0] - label.location[0])),
        float(box.location[0, 2] / label.location[0, 2] - 1.0),
        float(orientation_error(box.rotation_y, label.rotation_y)[0]),
        (length, width, height),
    )


def _summary(vehicles: Sequence[LabelledBox]) -> BoxesSummary:
    groups = np.unique([one.group for one in vehicles], return_inverse=True)[1]
    got = np.array([one.found for one in vehicles])
    degrees, shared = np.array([one.degrees for one in vehicles]), np.array([one.overlap for one in vehicles])
    metres = np.array([one.metres for one in vehicles])[got]
    sizes = np.array([one.size for one in vehicles])[got].reshape(-1, 3)
    nothing = not got.any()
    length, width, height = (np.full(3, np.nan) if nothing else sizes.mean(axis=0)).tolist()
    return BoxesSummary(
        vehicles=len(vehicles),
        found=int(got.sum()),
        right=tuple(mean_interval(100.0 * (shared >= least), groups) for least in LEAST_OVERLAPS),
        within=tuple(mean_interval(100.0 * (degrees <= most), groups) for most in THRESHOLDS),
        turned=np.nan if nothing else 100.0 * float((degrees[got] > TURNED_ROUND).mean()),
        mean_metres=None if nothing else mean_interval(metres, groups[got]),
        median_metres=np.nan if nothing else float(np.median(metres)),
        depth=np.nan if nothing else 100.0 * float(np.median([one.depth for one in vehicles if one.found])),
        size=(length, width, height),
    )


def _plain(summary: BoxesSummary) -> dict[str, Any]:
    told: dict[str, Any] = finite(vars(summary))
    for name in ("right", "within"):
        told[name] = [vars(one) for one in getattr(summary, name)]
    told["mean_metres"] = None if summary.mean_metres is None else vars(summary.mean_metres)
    return told
