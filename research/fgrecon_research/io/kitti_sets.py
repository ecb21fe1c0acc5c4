"""KITTI's sets of label, result, image set and detection files, with every defect named and counted.

Nothing is skipped silently: whatever cannot be used becomes a `Fault`, which the readers return beside what could be
read.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

import numpy as np

from fgrecon.core.choices import BoxModel
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.text import counted
from fgrecon.io.files import filled_lines, read_text, write_text
from fgrecon.io.kitti_files import (
    DETECTION_CLASSES,
    DetectionLine,
    Objects,
    format_results,
    parse_detection,
    parse_object,
)


class Defect(StrEnum):
    """What can be wrong with a set of files."""

    MISSING_FRAME = "missing frame"
    """A frame that is of the set has no file, or no detection."""
    UNKNOWN_FRAME = "unknown frame"
    """A file, or a line, is about a frame that is not of the set."""
    EMPTY_FILE = "empty file"
    """A file has no line."""
    UNREADABLE_FILE = "unreadable file"
    """A file is not text, or cannot be opened."""
    MALFORMED_LINE = "malformed line"
    """A line has the wrong number of columns or a column that is no number."""


@dataclass(frozen=True)
class Fault:
    """One defect: what, where (file and line, or frame), and what was found there."""

    defect: Defect
    place: str
    detail: str

    def __str__(self) -> str:
        """One line for a report."""
        return f"{self.defect}: {self.place}: {self.detail}"


def count_defects(problems: Iterable[Fault]) -> dict[str, int]:
    """How often each defect occurs, by its name."""
    counts = Counter(problem.defect for problem in problems)
    return {str(defect): counts[defect] for defect in Defect if counts[defect]}


def stated_model(path: Path) -> BoxModel | None:
    """What the boxes of a file of detections enclose, where its lines say it.

    Raises:
        InvalidInputError: The file cannot be read, or its lines do not agree.
    """
    found: set[BoxModel | None] = set()
    for _, line in filled_lines(path, "file"):
        with suppress(ValueError):  # reported by whoever reads the boxes
            found.add(parse_detection(line).model)
    if len(found) > 1:
        kinds = ", ".join(sorted("nothing" if model is None else model for model in found))
        raise InvalidInputError(str(path), f"boxes that enclose {kinds}", "Say it of all with --box-model.")
    return found.pop() if found else None


def parse_objects(text: str, place: str, *, scored: bool = False) -> tuple[Objects, list[Fault]]:
    """Read the lines of a label file, or of a result file, whose lines have a score.

    Returns:
        The objects of the lines that can be used, and a problem for each line that cannot, or for an empty file.
    """
    kinds, rows, problems = [], [], []
    for number, line in enumerate(text.splitlines(), start=1):
        if not line.strip():
            continue
        try:
            kind, numbers = parse_object(line, scored=scored)
        except ValueError as error:
            problems.append(Fault(Defect.MALFORMED_LINE, f"{place}:{number}", str(error)))
            continue
        kinds.append(kind)
        rows.append(numbers)
    if not kinds and not problems:
        problems.append(Fault(Defect.EMPTY_FILE, place, "no line"))
    return Objects.of_rows(kinds, np.array(rows)), problems


def read_image_set(path: Path) -> tuple[str, ...]:
    """Names of frames, one a line.

    Raises:
        InvalidInputError: The file cannot be read, is empty, or names a frame twice.
    """
    frames = tuple(read_text(path, "file").split())
    if not frames:
        raise InvalidInputError(str(path), "no frame", "Give a file with one frame name a line, such as 000001.")
    twice = [name for name, count in Counter(frames).items() if count > 1]
    if twice:
        raise InvalidInputError(str(path), twice[0], "Name each frame once.")
    return frames


def read_labels(folder: Path, frames: Sequence[str], *, scored: bool = False) -> tuple[dict[str, Objects], list[Fault]]:
    """Labels of the frames that have a file `<frame>.txt`, or results (16 columns); the others are problems.

    Raises:
        InvalidInputError: There is no such folder.
    """
    if not folder.is_dir():
        raise InvalidInputError("folder", str(folder), "Give a folder with one text file a frame.")
    found: dict[str, Objects] = {}
    problems: list[Fault] = []
    for frame in frames:
        path = folder / f"{frame}.txt"
        try:
            text = path.read_text(encoding="utf-8-sig")
        except FileNotFoundError:
            problems.append(Fault(Defect.MISSING_FRAME, frame, f"no file {path}"))
            continue
        except (OSError, UnicodeDecodeError) as error:
            problems.append(Fault(Defect.UNREADABLE_FILE, str(path), str(error)))
            continue
        found[frame], defects = parse_objects(text, str(path), scored=scored)
        problems += defects
    return found, problems


def read_detections(path: Path, frames: Sequence[str]) -> tuple[dict[str, Objects], list[Fault]]:
    """2D detections from one file with lines `image class score x1 y1 x2 y2` (`DETECTION_CLASSES`).

    Returns:
        Detections of every frame, none for those that the file does not mention, which are problems as well.

    Raises:
        InvalidInputError: The file cannot be read.
    """
    rows: dict[str, list[DetectionLine]] = {frame: [] for frame in frames}
    problems: list[Fault] = []
    strangers: Counter[str] = Counter()
    for place, line in filled_lines(path, "file"):
        try:
            detection = parse_detection(line)
            if detection.label not in DETECTION_CLASSES:
                raise ValueError(f"class {detection.label} in '{line}' is none of {', '.join(DETECTION_CLASSES)}")
        except ValueError as error:
            problems.append(Fault(Defect.MALFORMED_LINE, place, str(error)))
            continue
        frame = Path(detection.image).stem
        if frame in rows:
            rows[frame].append(detection)
        else:
            strangers[frame] += 1
    problems += [
        Fault(Defect.UNKNOWN_FRAME, f, f"{counted(n, 'detection')} in {path}") for f, n in sorted(strangers.items())
    ]
    problems += [Fault(Defect.MISSING_FRAME, f, f"no detection in {path}") for f, found in rows.items() if not found]
    return {frame: _detected(found) for frame, found in rows.items()}, problems


def _detected(found: Sequence[DetectionLine]) -> Objects:
    kinds, boxes = [DETECTION_CLASSES[one.label] for one in found], [one.box for one in found]
    return Objects.detections(kinds, np.array(boxes).reshape(-1, 4), np.array([one.score for one in found]))


def write_results(folder: Path, results: Mapping[str, Objects]) -> None:
    """Write one result file a frame, `<frame>.txt`; a frame without objects gets an empty file, as KITTI wants it.

    Raises:
        InvalidInputError: The folder cannot be written to.
    """
    folder.mkdir(parents=True, exist_ok=True)
    for frame, objects in results.items():
        write_text(folder / f"{frame}.txt", format_results(objects))
