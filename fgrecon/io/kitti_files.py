"""Files of KITTI: lines of labels, results, tracks and detections, the objects that they are of, and images with them.

A line of a label file (object set) is `type truncated occluded alpha x1 y1 x2 y2 h w l x y z rotation_y`; results add a
score as the 16th column; lines of the tracking set begin with the frame and the number of the track.

A drive is a folder with `image_02/FFFFFF.jpg` (or png), `calib.txt`, and `label_02.txt` in the format of KITTI's
tracking set: frame and number of the track, then the columns of an object label. Two files may stand beside them:
`clean_tracks.json` names, for each track (`"NUMBER KIND"`), the frames in which it can be used, and
`object_frames.json` the only frames that are labelled at all.

A folder of single images has the layout of KITTI's object set: `image_2`, `label_2` and `calib`, with a file for each
image. There every object is a track of its own.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.camera import MIN_DEPTH
from fgrecon.core.choices import BoxModel
from fgrecon.core.errors import InvalidInputError
from fgrecon.io.files import filled_lines
from fgrecon.io.json_fields import read_json
from fgrecon.io.kitti_calibration import KittiCalibration, read_calibration

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


IMAGES_PER_SECOND = 10.0
"""Of KITTI's drives."""

_SUFFIXES = "jpg", "png"
_DRIVE, _SINGLE = "label_02.txt", "label_2"
_NOTHING = TrackedObjects(Objects.of_rows([], np.zeros((0, 14))), np.zeros(0, dtype=np.int64))


@dataclass(frozen=True, eq=False)
class DriveFrame:
    """One image of a drive."""

    number: int  # of the frame
    image: Path  # its file
    objects: Objects  # labelled objects, whatever their kind; none where the frame is not labelled
    tracks: NDArray[np.int64]  # (M,) number of the track of each
    usable: NDArray[np.bool_]  # (M,) whether nothing is drawn over the object in this image
    labelled: bool  # whether the frame was labelled
    calibration: KittiCalibration  # the camera, and the labels' offset in its frame
    time: float | None = None  # when the image was taken, seconds, or None
    world_T_camera: NDArray[np.float64] | None = None  # (4, 4) pose of the camera in the drive's world, or None
    sweep: Path | None = None  # file of a LiDAR's points, where the data set names it; KITTI's lie beside the images

    @property
    def seconds(self) -> float:
        """When the image was taken; where nothing tells it by its number, at KITTI's rate."""
        return self.number / IMAGES_PER_SECOND if self.time is None else self.time

    @property
    def boxed(self) -> NDArray[np.bool_]:
        """(M,) whether each object has a 3D box in front of the camera; KITTI marks missing ones by -1 and -1000."""
        depth = self.objects.location[:, 2] + self.calibration.label_offset[2]
        return np.all(self.objects.size > 0.0, axis=1) & (depth > MIN_DEPTH)


@dataclass(frozen=True, eq=False)
class Drive:
    """Consecutive images by one camera, or single images."""

    name: str  # of its folder
    frames: tuple[DriveFrame, ...]  # those that have an image, in order; at least one

    @property
    def calibration(self) -> KittiCalibration:
        """Camera and offset of the first image: those of a drive are all alike, those of single images need not be."""
        return self.frames[0].calibration


def has_labels(folder: Path) -> bool:
    """Whether it is a drive or a folder of single images."""
    return (folder / _DRIVE).is_file() or (folder / _SINGLE).is_dir()


def read_images(folder: Path) -> Drive:
    """Read a drive or a folder of single images, whichever it is; the images are not opened."""
    if (folder / _DRIVE).is_file():
        return read_drive(folder)
    if (folder / _SINGLE).is_dir():
        return read_object_folder(folder)
    fix = f"Give a folder with {_DRIVE} (KITTI's tracking set) or with {_SINGLE} (its object set)."
    raise InvalidInputError("drive", str(folder), fix)


def read_drive(folder: Path, tracks: Path | None = None) -> Drive:
    """Read a drive; the images are not opened.

    Args:
        tracks: A tracker's results in the place of the labels: kinds, 2D boxes and numbers alone are taken.
    """
    if tracks is None:
        rows = read_tracking(folder / _DRIVE, f"Give a folder with {_DRIVE} of KITTI's tracking set.", results=False)
    else:
        results = read_tracking(tracks, "Give results in the format of KITTI's tracking set.")
        rows = {number: replace(one, objects=one.objects.flat()) for number, one in results.items()}
    clean = _optional(folder / "clean_tracks.json")
    labelled = _optional(folder / "object_frames.json")
    calibration = read_calibration(folder / "calib.txt")
    frames = []
    for number, image in _images(folder / "image_02"):
        found = rows.get(number, _NOTHING)
        frames.append(
            DriveFrame(
                number=number,
                image=image,
                objects=found.objects,
                tracks=found.tracks,
                usable=np.array(
                    [
                        clean is None or number in clean.get(f"{track} {kind}", ())
                        for track, kind in zip(found.tracks.tolist(), found.objects.kind, strict=True)
                    ],
                    dtype=bool,
                ),
                labelled=labelled is None or str(number) in labelled,
                calibration=calibration,
            )
        )
    return Drive(folder.name, tuple(frames))


def read_object_folder(folder: Path) -> Drive:
    """Read single images in the layout of KITTI's object set, those that have an image; the images are not opened.

    The tracks are numbered through the folder, in the order of the images and of the lines of their label files.
    """
    frames: list[DriveFrame] = []
    count = 0
    for number, image in _images(folder / "image_2"):
        path = folder / _SINGLE / f"{image.stem}.txt"
        rows = []
        for place, line in filled_lines(path, "labels", "Give a label file for every image."):
            try:
                rows.append(parse_object(line))
            except ValueError as error:
                raise InvalidInputError(place, str(error), "Give lines of an object label.") from error
        frames.append(
            DriveFrame(
                number=number,
                image=image,
                objects=Objects.of_rows([kind for kind, _ in rows], np.array([numbers for _, numbers in rows])),
                tracks=np.arange(count, count + len(rows), dtype=np.int64),
                usable=np.ones(len(rows), dtype=bool),
                labelled=True,
                calibration=read_calibration(folder / "calib" / f"{image.stem}.txt"),
            )
        )
        count += len(rows)
    return Drive(folder.name, tuple(frames))


def _images(folder: Path) -> list[tuple[int, Path]]:
    """The images of a folder by the number that names each, in order."""
    found: dict[int, Path] = {}
    for path in sorted(p for suffix in _SUFFIXES for p in folder.glob(f"*.{suffix}")):
        if not path.stem.isdecimal():
            raise InvalidInputError(str(path), path.stem, "Name images by their frame's number.")
        if int(path.stem) in found:
            raise InvalidInputError(str(path), f"frame {int(path.stem)}, twice", "Give each frame one image.")
        found[int(path.stem)] = path
    if not found:
        raise InvalidInputError("drive", str(folder), "Give a folder with images FFFFFF.jpg or .png.")
    return sorted(found.items())


def _optional(path: Path) -> dict[str, Any] | None:
    """A JSON object, where the file exists."""
    if not path.exists():
        return None
    content = read_json(path)
    if not isinstance(content, dict):
        raise InvalidInputError(str(path), type(content).__name__, "Give an object by track or frame.")
    return content
