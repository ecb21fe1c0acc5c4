"""The files of a run as rows of tasks: counted first, then read as a stream, each row with an id of its own.

| file | rows | row_id |
|---|---|---|
| `.jsonl`, `.ndjson` | a line each: an instance of a keypoint file | `FILE#LINE` |
| `.json` | a keypoint file of any format, or a track: an instance each | `FILE#NUMBER` |
| `.txt`, `.mat` | CarFusion's and PASCAL3D+'s keypoints: an instance each | `FILE#NUMBER` |
| `.parquet` | a row each: its columns are the fields of an instance, or `instance`, `image` | `FILE#NUMBER` |
| an image | one | `FILE` |
| a video | a frame each | `FILE#FRAME` |

A folder stands for the images and videos below it, in order; where there are none, for its keypoint files; where there
are none of these either, for its files `.txt` and `.mat`. A sequence of a data set stands for its images, with their
cameras. KITTI's folders (`image_2` or `image_02` with `calib`) bring
their cameras.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from fgrecon.batch.parts import RUN
from fgrecon.batch.schema import instance_text
from fgrecon.core.camera import Camera
from fgrecon.core.category import Category
from fgrecon.core.errors import FgreconError, InvalidInputError
from fgrecon.core.text import whole_text
from fgrecon.io.catalogue import load_category
from fgrecon.io.datasets import is_data_set, open_images
from fgrecon.io.images import IMAGES, refuse_unread
from fgrecon.io.keypoints.records import NOT_JSON, keypoint_records
from fgrecon.io.kitti_calibration import calibration_beside, read_calibration
from fgrecon.io.video_frames import VIDEOS, count_frames

__all__ = ["IMAGES", "VIDEOS", "InputFile", "sources_of"]

_LEFT_COLOUR = ("image_2", "image_02")
_CHUNK = 1024  # rows of Parquet in memory

Row = dict[str, Any]


@dataclass(frozen=True)
class InputFile:
    """A file of a run.

    Attributes:
        path: The file, as it was given.
        every: Of a video every so many frames.
        category: The category whose keypoints are wanted.
        camera: Of an image of a data set its camera as JSON, or None.
        calib: Folder with a calibration of KITTI's for each image, of its name; or None.
    """

    path: Path
    every: int = 1
    category: Category = field(default_factory=lambda: load_category("car14"))
    camera: str | None = None
    calib: Path | None = None

    @property
    def is_picture(self) -> bool:
        """Whether its rows are images, each of which takes a moment."""
        return self.path.suffix.lower() in (*IMAGES, *VIDEOS)

    def _check_name(self) -> None:
        if self.is_picture and whole_text(str(self.path)) != str(self.path):  # OpenCV ends the process then
            raise InvalidInputError("image", str(self.path), "Rename it: tables cannot hold a name that is not UTF-8.")

    def count(self) -> int:
        """How many rows it has; a file that cannot be read has one, which tells why."""
        try:
            self._check_name()
            return _READERS[self.path.suffix.lower()].count(self)
        except (FgreconError, OSError):
            return 1

    def rows(self) -> Iterator[Row]:
        """Its rows, one after the other; what cannot be read becomes a row that says so, and ends the file."""
        try:
            self._check_name()
            for row in _READERS[self.path.suffix.lower()].rows(self):
                yield {"source": str(self.path), **row}
        except (FgreconError, OSError) as error:
            yield {"row_id": f"{self.path}#unreadable", "source": str(self.path), "problem": str(error)}


@dataclass(frozen=True)
class _Reader:
    """How a kind of file is counted and read."""

    count: Callable[[InputFile], int]
    rows: Callable[[InputFile], Iterator[Row]]


def sources_of(
    inputs: Sequence[str | Path], every: int = 1, category: Category | str | Path = "car14"
) -> list[InputFile]:
    """The files that inputs stand for, each once.

    Args:
        inputs: Files and folders; of data sets (`fgrecon.io.datasets`) with the sequence, or the camera, that is meant.
        every: Of videos every so many frames.
        category: The category whose keypoints are wanted, its name or its file.

    Raises:
        InvalidInputError: One does not exist, is a pipe or device, has another ending, or is a folder without anything.
    """
    found: dict[Path, str | None] = {}
    for item in map(Path, inputs):
        if is_data_set(item):
            found |= {image.path: _as_json(image.lens) for image in open_images(item)}
            continue
        if not item.exists():
            raise InvalidInputError("input", str(item), "Give files and folders that exist.")
        if not (item.is_file() or item.is_dir()):  # files are read twice, once to count their rows
            raise InvalidInputError("input", f"{item}, a pipe or device", "Give files and folders.")
        if item.is_file() and item.suffix.lower() not in _READERS:
            refuse_unread(item, "input")
            raise InvalidInputError("input", str(item), f"Give a folder, or files ending in {', '.join(_READERS)}.")
        found |= dict.fromkeys(_files(item) if item.is_dir() else [item])
    wanted = load_category(category)
    return [InputFile(path, every, wanted, camera) for path, camera in found.items()]


def _files(folder: Path) -> list[Path]:
    """The files of a folder, in order."""
    (left, *_) = [folder / name for name in _LEFT_COLOUR if (folder / name).is_dir()] or [folder]
    below = sorted(path for path in _below(left) if path.suffix.lower() in _READERS and path.is_file())
    results = {path.parent for path in below if path.name == RUN}  # of an earlier run, into a folder inside this one
    inputs = [path for path in below if results.isdisjoint(path.parents)]
    pictures = [path for path in inputs if path.suffix.lower() in (*IMAGES, *VIDEOS)]
    if not inputs:
        refuse_unread(left, "input")
        raise InvalidInputError("input", str(folder), "Give a folder with images, videos or keypoint files.")
    return pictures or [path for path in inputs if path.suffix.lower() not in NOT_JSON] or inputs


def _below(folder: Path) -> Iterator[Path]:
    """Every file below a folder that is not hidden, in linked folders too; each folder once, if links lead to it."""
    been: set[str] = set()
    for here, folders, names in os.walk(folder, followlinks=True):
        new = (place := os.path.realpath(here)) not in been
        been.add(place)
        folders[:] = sorted(name for name in folders if new and not name.startswith("."))  # the same links each time
        yield from (Path(here, name) for name in names if new and not name.startswith("."))


def _count_lines(source: InputFile) -> int:
    with source.path.open("rb") as file:
        return sum(1 for line in file if line.strip())


def _lines(source: InputFile) -> Iterator[Row]:
    with source.path.open(encoding="utf-8-sig", errors="replace") as file:
        for number, line in enumerate(file, start=1):
            if line.strip():  # one that somebody is still writing is another row once it is whole
                whole = line.endswith("\n") or _is_json(line)
                name = f"{source.path}#{number}" if whole else f"{source.path}#{number}-unfinished"
                yield {"row_id": name, "instance": line.strip()}


def _is_json(text: str) -> bool:
    try:
        json.loads(text)
    except (ValueError, RecursionError):
        return False
    return True


def _count_records(source: InputFile) -> int:
    return len(keypoint_records(source.path, source.category))


def _record_rows(source: InputFile) -> Iterator[Row]:
    for number, item in enumerate(keypoint_records(source.path, source.category)):
        content = {"problem": str(item)} if isinstance(item, FgreconError) else {"instance": json.dumps(item)}
        yield {"row_id": f"{source.path}#{number}", **content}


def _count_parquet(source: InputFile) -> int:
    return int(_parquet(source).metadata.num_rows)


def _parquet(source: InputFile) -> Any:
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        file = pq.ParquetFile(pa.OSFile(os.fsencode(source.path)))  # a name that is no text too
    except pa.ArrowException as error:
        raise InvalidInputError(str(source.path), str(error), "Give a Parquet file.") from error
    columns = file.schema_arrow
    if "instance" in columns.names and not {"image", "keypoints"} & set(columns.names):
        kind = columns.field("instance").type  # beside other fields it may mean anything
        if not (_is_text(kind) or (pa.types.is_dictionary(kind) and _is_text(kind.value_type))):
            fix = "Let it be text: the JSON of an instance of a keypoint file."
            raise InvalidInputError(f"{source.path}: column instance", f"the type {kind}", fix)
    return file


def _is_text(kind: Any) -> bool:
    import pyarrow as pa

    return bool(pa.types.is_string(kind) or pa.types.is_large_string(kind) or pa.types.is_null(kind))


def _parquet_rows(source: InputFile) -> Iterator[Row]:
    import pyarrow as pa

    number = 0
    try:
        for batch in _parquet(source).iter_batches(batch_size=_CHUNK):
            for row in batch.to_pylist():
                yield {"row_id": f"{source.path}#{number}", **_task(row)}
                number += 1
    except pa.ArrowException as error:
        raise InvalidInputError(str(source.path), str(error), "Give a Parquet file that is whole.") from error


_ASIDE = {"image": str, "instance": str, "camera": str, "frame": int}
"""Columns of Parquet that are no fields of an instance."""


def _task(row: Row) -> Row:
    """What a row of Parquet asks for: an image, an instance as text, or an instance by its fields."""
    own = () if row.get("keypoints") is None else ("image",)  # the instance's, which says where its points are from
    aside = {name: row.pop(name) for name in _ASIDE if row.get(name) is not None and name not in own}
    if "image" not in aside:
        aside = {name: value for name, value in aside.items() if isinstance(value, _ASIDE[name])}
        return {"instance": instance_text(row), **aside}
    wrong = [name for name, value in aside.items() if not isinstance(value, _ASIDE[name])]
    if wrong:
        return {"problem": f"column {wrong[0]} holds {type(aside[wrong[0]]).__name__}, not {_ASIDE[wrong[0]].__name__}"}
    return aside


def _image_row(source: InputFile) -> Iterator[Row]:
    yield {"row_id": str(source.path), "image": str(source.path), "camera": source.camera or _kitti_camera(source)}


def _frame_rows(source: InputFile) -> Iterator[Row]:
    for frame in range(0, count_frames(source.path), source.every):
        yield {"row_id": f"{source.path}#{frame}", "image": str(source.path), "frame": frame}


def _kitti_camera(source: InputFile) -> str | None:
    """The camera that KITTI's layouts have for an image, or its file in the folder of calibrations, as JSON."""
    if source.calib is not None:
        return _as_json(read_calibration(source.calib / f"{source.path.stem}.txt").camera)
    found = calibration_beside(source.path)
    return None if found is None else json.dumps({"K": found.camera.matrix.tolist()})


def _as_json(camera: Camera) -> str:
    return json.dumps({"K": camera.matrix.tolist(), **camera.lens_fields})


_RECORDS = _Reader(_count_records, _record_rows)
_LINES = _Reader(_count_lines, _lines)
_IMAGE = _Reader(lambda _: 1, _image_row)
_VIDEO = _Reader(lambda source: -(-count_frames(source.path) // source.every), _frame_rows)
_READERS: Mapping[str, _Reader] = {
    ".json": _RECORDS,
    **dict.fromkeys(NOT_JSON, _RECORDS),
    ".jsonl": _LINES,
    ".ndjson": _LINES,
    ".parquet": _Reader(_count_parquet, _parquet_rows),
    **dict.fromkeys(IMAGES, _IMAGE),
    **dict.fromkeys(VIDEOS, _VIDEO),
}
