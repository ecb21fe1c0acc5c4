"""Lines of KITTI's label, result, tracking and detection files, and the objects that they are of.

A line of a label file (object set) is `type truncated occluded alpha x1 y1 x2 y2 h w l x y z rotation_y`; results add a
score as the 16th column; lines of the tracking set begin with the frame and the number of the track.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.choices import BoxModel
from fgrecon.core.errors import InvalidInputError
from fgrecon.io.text_lines import filled_lines

DETECTION_CLASSES = {"1": "Pedestrian", "2": "Car", "3": "Cyclist"}
_DETECTION_NUMBERS = {name.lower(): number for number, name in DETECTION_CLASSES.items()}
"""Numbers of the classes in detection files."""

LABEL_COLUMNS = 15
"""Columns of a line of a label file; a result has its score after them."""
_DETECTION_COLUMNS = 7
UNKNOWN = -1.0


class DetectionLine(NamedTuple):
    """One line of a file of detections."""

    image: str  # name of the image
    label: str  # number of the class
    score: float  # how sure the detector is
    box: list[float]  # x1, y1, x2, y2 in pixels
    model: BoxModel | None  # what the box encloses, where the line says it


@dataclass(frozen=True)
class Objects:
    """The M objects of one frame, column by column."""

    kind: tuple[str, ...]  # M types as written, such as `Car` or `DontCare`
    truncation: NDArray[np.float64]  # (M,) share outside the image, 0 to 1; -1 where unknown
    occlusion: NDArray[np.int64]  # (M,) 0 fully visible, 1 partly, 2 largely occluded, 3 unknown; -1 where not given
    alpha: NDArray[np.float64]  # (M,) observation angle, radians; -10 where invalid
    box: NDArray[np.float64]  # (M, 4) 2D box x1, y1, x2, y2 in pixels
    size: NDArray[np.float64]  # (M, 3) length, width and height, metres
    location: NDArray[np.float64]  # (M, 3) centre of the bottom face in the rectified reference camera, metres
    rotation_y: NDArray[np.float64]  # (M,) yaw about the camera's y axis, radians
    score: NDArray[np.float64]  # (M,) of results; NaN in labels

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
            [UNKNOWN, UNKNOWN, -10.0, *4 * [0.0], *3 * [UNKNOWN], *3 * [-1000.0], -10.0, 0.0], (len(kind), 1)
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

    The class is a number, or the name of one without regard to capitals.

    A box model (`detected`) may stand behind it, in each line: files of detections are joined and parts taken out.

    Raises:
        ValueError: The line is none.
    """
    numbers, _, last = line.rstrip().rpartition(" ")
    model = BoxModel(last) if last in set(BoxModel) else None
    words = (line if model is None else numbers).rsplit(maxsplit=_DETECTION_COLUMNS - 1)
    if len(words) != _DETECTION_COLUMNS or not (words[1].isdecimal() or words[1].lower() in _DETECTION_NUMBERS):
        raise ValueError(f"'{line}' is not: image, class, score, x1, y1, x2, y2")
    score, *box = _finite(words[2:], line)
    label = _DETECTION_NUMBERS.get(words[1].lower(), words[1])
    return DetectionLine(words[0].strip(), label, score, box, model)


def _finite(words: Sequence[str], line: str) -> list[float]:
    numbers = [float(word) for word in words]
    if not np.isfinite(numbers).all():
        raise ValueError(f"a number that is not finite in '{line}'")
    return numbers


def format_results(objects: Objects) -> str:
    """The objects as lines of KITTI's result format: 16 columns, a score of 1 where there is none."""
    score = np.where(np.isnan(objects.score), 1.0, objects.score)
    truncation = ["-1" if value == UNKNOWN else f"{value:.2f}" for value in objects.truncation]
    lines = []
    for i, kind in enumerate(objects.kind):
        length, width, height = objects.size[i]
        numbers = (height, width, length, *objects.location[i], objects.rotation_y[i], score[i])
        start = f"{kind} {truncation[i]} {objects.occlusion[i]} {objects.alpha[i]:.4f}"
        box = " ".join(f"{value:.2f}" for value in objects.box[i])
        lines.append(f"{start} {box} {' '.join(f'{value:.4f}' for value in numbers)}\n")
    return "".join(lines)


_FIX = "Give lines of frame, track and an object label."


@dataclass(frozen=True, eq=False)
class TrackedObjects:
    """The M objects of one frame."""

    objects: Objects  # what they are and where
    tracks: NDArray[np.int64]  # (M,) number of the track of each; -1 for none


def read_tracking(path: Path, fix: str = _FIX, *, results: bool = True) -> dict[int, TrackedObjects]:
    """The objects of a file of labels, or of results with scores, by frame; a frame that has none is not there.

    Args:
        path: Text file.
        fix: What to do where it cannot be read, for the error.
        results: Whether lines may have a score after the label.
    """
    rows: dict[int, list[tuple[int, str, list[float]]]] = defaultdict(list)
    for place, line in filled_lines(path, "labels", fix):
        try:
            frame, track, rest = line.split(maxsplit=2)
            scored = results and len(rest.split()) > LABEL_COLUMNS
            kind, numbers = parse_object(rest, scored=scored)
            known = int(np.int64(int(frame))), int(np.int64(int(track)))
            rows[known[0]].append((known[1], kind, numbers if scored else [*numbers, np.nan]))
        except (ValueError, OverflowError) as error:
            raise InvalidInputError(place, str(error), _FIX) from error
    return {
        frame: TrackedObjects(
            Objects.of_rows([kind for _, kind, _ in found], np.array([numbers for _, _, numbers in found])),
            np.array([track for track, _, _ in found], dtype=np.int64),
        )
        for frame, found in rows.items()
    }


def format_tracking(frames: Mapping[int, TrackedObjects]) -> str:
    """Lines of KITTI's tracking results: frame, track, and the columns of a result."""
    lines = []
    for frame, found in sorted(frames.items()):
        results = format_results(found.objects).splitlines(keepends=True)
        lines += [f"{frame} {track} {line}" for track, line in zip(found.tracks.tolist(), results, strict=True)]
    return "".join(lines)
