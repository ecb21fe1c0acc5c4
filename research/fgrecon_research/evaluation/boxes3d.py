"""3D boxes of any source against KITTI's labels, several sources side by side: what each labelled vehicle got.

Vehicles count as in `fgrecon.calibration.labelled_boxes` (`wanted`): cars and vans of at least 25 px. Each gets the
box of a car, or else of a van, that overlaps it most in the image and is no other's; one without any counts in every
share. `fgrecon_research.evaluation.boxes_summary` says what they come to.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from fgrecon.calibration.labelled_boxes import matched, wanted
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.metrics import FAILURE_DEGREES, orientation_error
from fgrecon.io.files import filled_lines, read_text
from fgrecon.io.kitti_files import LABEL_COLUMNS, Drive, Objects, read_tracking
from fgrecon_research.evaluation.kitti_devkit import Space, overlap
from fgrecon_research.io.kitti_sets import Defect, parse_objects

_NAME = "{:06d}"  # of a frame
_NOTHING = Objects.of_rows([], np.zeros((0, LABEL_COLUMNS)))


@dataclass(frozen=True)
class LabelledBox:
    """One labelled vehicle, and the box that a source has for it."""

    drive: str  # name of the drive, or of the folder of single images
    frame: str  # name of the frame
    index: int  # position among the frame's labels
    kind: str  # `Car` or `Van`
    distance: float  # of the labelled origin, metres
    group: str  # what errs alike: its track in a drive, its image among single ones
    found: bool  # whether there is a box
    overlap: float  # intersection over union in 3D, and
    footprint: float  # from above; 0 without a box
    metres: float  # distance of the origins; infinite without a box
    depth: float  # relative error of the depth; NaN without a box
    degrees: float  # yaw error on the full circle; 180 without a box
    # (3,) length, width and height, estimated minus labelled, metres; NaN without a box
    size: tuple[float, float, float]


def read_boxes(path: Path, frames: Sequence[int]) -> dict[int, Objects]:
    """Boxes by frame, of those frames that the source speaks of.

    Args:
        path: Folder with a file of KITTI's object lines a frame, named by its number, or one file of KITTI's tracking
            lines, which speaks of every frame; or the folder of `fgrecon run`, which speaks of those that it read. A
            line without a score has the score 1.

    Raises:
        InvalidInputError: It cannot be read, or a line is malformed; names file and line.
    """
    if (summary := path / "frames.jsonl").is_file():
        try:
            known = {json.loads(line)["frame"] for _, line in filled_lines(summary, "results")}
            frames = sorted(known.intersection(frames))
        except (ValueError, KeyError, TypeError) as error:
            raise InvalidInputError("results", str(summary), "Give the folder of a run, as `run` wrote it.") from error
        path = path / "tracks.txt"
    if path.is_dir():
        files = {number: path / f"{_NAME.format(number)}.txt" for number in frames}
        texts = {number: read_text(file, "results") for number, file in files.items() if file.is_file()}
        if not texts:
            fix = "Give a folder with files FFFFFF.txt of labelled frames, or a file of tracking lines."
            raise InvalidInputError("results", str(path), fix)
        return {number: _objects(text, str(files[number])) for number, text in texts.items()}
    if not path.is_file():
        raise InvalidInputError("results", str(path), "Give a folder of boxes, or a file of tracking lines.")
    tracked = {number: found.objects for number, found in read_tracking(path).items()}
    scored = {n: replace(one, score=np.nan_to_num(one.score, nan=1.0)) for n, one in tracked.items()}
    return {number: scored.get(number, _NOTHING) for number in frames}


def read_boxes_of_drives(path: Path, drives: Sequence[Drive]) -> dict[str, dict[int, Objects]]:
    """Boxes by the drive's name and the frame, of the labelled frames that the source speaks of.

    Args:
        path: Folder with a folder or file (`.txt`) for each drive, by its name, as `read_boxes` takes it; of a single
            drive also what `read_boxes` takes itself. Drives that are not there are left out.

    Raises:
        InvalidInputError: There is none of the drives, one cannot be read, or a line is malformed; names file and line.
    """
    found = {}
    for drive in drives:
        place = _place(path, drive.name, alone=len(drives) == 1)
        if place is not None:
            found[drive.name] = read_boxes(place, [frame.number for frame in drive.frames if frame.labelled])
    if not found:
        name = drives[0].name
        raise InvalidInputError("results", str(path), f"Give a folder with a folder {name} of boxes, or {name}.txt.")
    return found


def score(
    drive: Drive, results: Mapping[int, Objects], frames: Sequence[int], *, least: float = 0.5, min_score: float = 0.0
) -> list[LabelledBox]:
    """What each labelled vehicle that counts got."""
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
            box = None if j < 0 else boxes.take(np.array([j]))
            found.append(scored_box(drive.name, name, row, group, label, box))
    return found


def scored_box(drive: str, frame: str, index: int, group: str, label: Objects, box: Objects | None) -> LabelledBox:
    """A labelled vehicle, at an index among the frame's labels, and its one box, if there is any."""
    about = (drive, frame, index, label.kind[0], float(np.linalg.norm(label.location[0])), group, box is not None)
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


def _place(path: Path, drive: str, *, alone: bool) -> Path | None:
    folder, file = path / drive, path / f"{drive}.txt"
    if folder.is_dir():
        return folder
    if alone:
        return path
    return file if file.is_file() else None


def _objects(text: str, place: str) -> Objects:
    """Lines of labels or results; labels have the score 1."""
    scored = [line if len(line.split()) != LABEL_COLUMNS else f"{line} 1" for line in text.splitlines()]
    objects, faults = parse_objects("\n".join(scored), place, scored=True)
    faults = [fault for fault in faults if fault.defect is Defect.MALFORMED_LINE]
    if faults:
        raise InvalidInputError(faults[0].place, str(faults[0]), "Give lines of KITTI's object results.")
    return objects
