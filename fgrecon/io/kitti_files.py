"""KITTI's label, result, image set and detection files, with every defect named and counted.

A line of a label file (object set) is `type truncated occluded alpha x1 y1 x2 y2 h w l x y z rotation_y`; results add a
score as the 16th column. Nothing is skipped silently: whatever cannot be used becomes a `Fault`, which the readers
return beside what could be read.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, fields, replace
from enum import StrEnum
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.choices import BoxModel
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.text import counted
from fgrecon.io.files import write_text

__all__ = [
    "DETECTION_CLASSES",
    "LABEL_COLUMNS",
    "Defect",
    "DetectionLine",
    "Fault",
    "Objects",
    "count_defects",
    "format_results",
    "parse_detection",
    "parse_object",
    "parse_objects",
    "read_detections",
    "read_image_set",
    "read_labels",
    "read_results",
    "stated_model",
    "write_results",
]

DETECTION_CLASSES = {"1": "Pedestrian", "2": "Car", "3": "Cyclist"}
"""Numbers of the classes in detection files."""

LABEL_COLUMNS = 15
"""Columns of a line of a label file; a result has its score after them."""
_DETECTION_COLUMNS = 7
_UNKNOWN = -1.0


class Defect(StrEnum):
    """What can be wrong with a set of files."""

    MISSING_FRAME = "missing frame"
    """A frame that was asked for has no file, or no detection."""
    UNKNOWN_FRAME = "unknown frame"
    """A file, or a line, is about a frame that was not asked for."""
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


class DetectionLine(NamedTuple):
    """One line of a file of detections.

    Attributes:
        image: Name of the image.
        label: Number of the class.
        score: How sure the detector is.
        box: x1, y1, x2, y2 in pixels.
        model: What the box encloses, where the line says it.
    """

    image: str
    label: str
    score: float
    box: list[float]
    model: BoxModel | None


def count_defects(problems: Iterable[Fault]) -> dict[str, int]:
    """How often each defect occurs, by its name."""
    counts = Counter(problem.defect for problem in problems)
    return {str(defect): counts[defect] for defect in Defect if counts[defect]}


@dataclass(frozen=True)
class Objects:
    """The M objects of one frame, column by column.

    Attributes:
        kind: M types as written, such as `Car` or `DontCare`.
        truncation: (M,) share outside the image, 0 to 1; -1 where unknown.
        occlusion: (M,) 0 fully visible, 1 partly, 2 largely occluded, 3 unknown; -1 where not given.
        alpha: (M,) observation angle, radians; -10 where invalid.
        box: (M, 4) 2D box x1, y1, x2, y2 in pixels.
        size: (M, 3) length, width and height, metres.
        location: (M, 3) centre of the bottom face in the rectified reference camera, metres.
        rotation_y: (M,) yaw about the camera's y axis, radians.
        score: (M,) of results; NaN in labels.
    """

    kind: tuple[str, ...]
    truncation: NDArray[np.float64]
    occlusion: NDArray[np.int64]
    alpha: NDArray[np.float64]
    box: NDArray[np.float64]
    size: NDArray[np.float64]
    location: NDArray[np.float64]
    rotation_y: NDArray[np.float64]
    score: NDArray[np.float64]

    def __len__(self) -> int:
        """Number of objects."""
        return len(self.kind)

    @classmethod
    def of_rows(cls, kind: Sequence[str], rows: NDArray[np.float64]) -> Objects:
        """From the numeric columns of label lines (M, 14), or of result lines (M, 15)."""
        rows = np.asarray(rows, dtype=np.float64).reshape(len(kind), -1 if len(kind) else LABEL_COLUMNS - 1)
        return cls(
            kind=tuple(kind),
            truncation=rows[:, 0],
            occlusion=rows[:, 1].astype(np.int64),
            alpha=rows[:, 2],
            box=rows[:, 3:7],
            size=rows[:, [9, 8, 7]],  # KITTI writes height, width, length
            location=rows[:, 10:13],
            rotation_y=rows[:, 13],
            score=rows[:, 14] if rows.shape[1] > LABEL_COLUMNS - 1 else np.full(len(kind), np.nan),
        )

    @classmethod
    def detections(cls, kind: Sequence[str], box: NDArray[np.float64], score: NDArray[np.float64]) -> Objects:
        """Objects of which only type, 2D box (M, 4) and score (M,) are known; the rest has KITTI's marks for that."""
        rows = np.tile(
            [_UNKNOWN, _UNKNOWN, -10.0, *4 * [0.0], *3 * [_UNKNOWN], *3 * [-1000.0], -10.0, 0.0], (len(kind), 1)
        )
        rows[:, 3:7], rows[:, 14] = np.reshape(box, (-1, 4)), score
        return cls.of_rows(kind, rows)

    def flat(self) -> Objects:
        """The same without 3D boxes: KITTI's marks for what is unknown."""
        bare = Objects.detections(self.kind, self.box, self.score)
        return replace(bare, truncation=self.truncation, occlusion=self.occlusion, alpha=self.alpha)

    def take(self, index: NDArray[np.intp] | NDArray[np.bool_]) -> Objects:
        """The objects at an index or mask."""
        arrays = {f.name: getattr(self, f.name)[index] for f in fields(self) if f.name != "kind"}
        return Objects(kind=tuple(np.array(self.kind, dtype=object)[index]), **arrays)


def parse_object(line: str, *, scored: bool = False) -> tuple[str, list[float]]:
    """Type and the 14 numbers of a line of a label file; 15, with the score, of a result file.

    Raises:
        ValueError: The line has another number of columns, or one that is no finite number.
    """
    kind, *words = line.split()
    if len(words) + 1 != LABEL_COLUMNS + scored:
        raise ValueError(f"{len(words) + 1} columns instead of {LABEL_COLUMNS + scored}")
    return kind, _finite(words, line)


def parse_detection(line: str) -> DetectionLine:
    """A line `image class score x1 y1 x2 y2` of a file of detections; the image's name may hold spaces.

    A box model (`detected`) may stand behind it, in each line: files of detections are joined and parts taken out.

    Raises:
        ValueError: The line is none.
    """
    numbers, _, last = line.rstrip().rpartition(" ")
    model = BoxModel(last) if last in set(BoxModel) else None
    words = (line if model is None else numbers).rsplit(maxsplit=_DETECTION_COLUMNS - 1)
    if len(words) != _DETECTION_COLUMNS or not words[1].isdecimal():
        raise ValueError(f"'{line}' is not: image, class, score, x1, y1, x2, y2")
    score, *box = _finite(words[2:], line)
    return DetectionLine(words[0].strip(), words[1], score, box, model)


def stated_model(path: Path) -> BoxModel | None:
    """What the boxes of a file of detections enclose, where its lines say it.

    Raises:
        InvalidInputError: The file cannot be read, or its lines do not agree.
    """
    found: set[BoxModel | None] = set()
    for line in _read(path).splitlines():
        with suppress(ValueError):  # told by whoever reads the boxes
            found.add(parse_detection(line).model)
    if len(found) > 1:
        kinds = ", ".join(sorted("nothing" if model is None else model for model in found))
        raise InvalidInputError(str(path), f"boxes that enclose {kinds}", "Say it of all with --box-model.")
    return found.pop() if found else None


def _finite(words: Sequence[str], line: str) -> list[float]:
    numbers = [float(word) for word in words]
    if not np.isfinite(numbers).all():
        raise ValueError(f"a number that is not finite in '{line}'")
    return numbers


def parse_objects(text: str, place: str, *, scored: bool = False) -> tuple[Objects, list[Fault]]:
    """Read the lines of a label file, or of a result file.

    Args:
        text: Content of the file.
        place: What to call it in problems.
        scored: Whether lines have a score (results).

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
    frames = tuple(_read(path).split())
    if not frames:
        raise InvalidInputError(str(path), "no frame", "Give a file with one frame name a line, such as 000001.")
    twice = [name for name, count in Counter(frames).items() if count > 1]
    if twice:
        raise InvalidInputError(str(path), twice[0], "Name each frame once.")
    return frames


def read_labels(folder: Path, frames: Sequence[str]) -> tuple[dict[str, Objects], list[Fault]]:
    """Labels of the frames that have a file `<frame>.txt`; the others are problems."""
    return _read_files(folder, frames, scored=False)


def read_results(folder: Path, frames: Sequence[str]) -> tuple[dict[str, Objects], list[Fault]]:
    """Results (16 columns) of the frames that have a file `<frame>.txt`.

    Frames without a file and files of other frames are problems; so are empty files, which count as no detection.
    """
    objects, problems = _read_files(folder, frames, scored=True)
    unknown = sorted({path.stem for path in folder.glob("*.txt")} - set(frames))
    problems += [Fault(Defect.UNKNOWN_FRAME, str(folder / f"{name}.txt"), "not in the image set") for name in unknown]
    return objects, problems


def _read_files(folder: Path, frames: Sequence[str], *, scored: bool) -> tuple[dict[str, Objects], list[Fault]]:
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
    for number, line in enumerate(_read(path).splitlines(), start=1):
        if not line.strip():
            continue
        try:
            detection = parse_detection(line)
            if detection.label not in DETECTION_CLASSES:
                raise ValueError(f"class {detection.label} in '{line}' is none of {', '.join(DETECTION_CLASSES)}")
        except ValueError as error:
            problems.append(Fault(Defect.MALFORMED_LINE, f"{path}:{number}", str(error)))
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


def format_results(objects: Objects) -> str:
    """The objects as lines of KITTI's result format: 16 columns, a score of 1 where there is none."""
    score = np.where(np.isnan(objects.score), 1.0, objects.score)
    truncation = ["-1" if value == _UNKNOWN else f"{value:.2f}" for value in objects.truncation]
    lines = []
    for i, kind in enumerate(objects.kind):
        length, width, height = objects.size[i]
        numbers = (height, width, length, *objects.location[i], objects.rotation_y[i], score[i])
        start = f"{kind} {truncation[i]} {objects.occlusion[i]} {objects.alpha[i]:.4f}"
        box = " ".join(f"{value:.2f}" for value in objects.box[i])
        lines.append(f"{start} {box} {' '.join(f'{value:.4f}' for value in numbers)}\n")
    return "".join(lines)


def write_results(folder: Path, results: Mapping[str, Objects]) -> None:
    """Write one result file a frame, `<frame>.txt`; a frame without objects gets an empty file, as KITTI wants it.

    Raises:
        InvalidInputError: The folder cannot be written to.
    """
    folder.mkdir(parents=True, exist_ok=True)
    for frame, objects in results.items():
        write_text(folder / f"{frame}.txt", format_results(objects))


def _read(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise InvalidInputError("file", str(path), f"Give a text file that can be read ({error}).") from error
