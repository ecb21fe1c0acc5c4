"""Data sets of drives, one module each: one description of all, and the data set that a path belongs to.

A path may be followed by what is meant of it: `PATH#SEQUENCE/CAMERA`, `PATH#SEQUENCE` where it has one camera, and
`PATH#CAMERA` where it has one sequence.
"""

from __future__ import annotations

from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from typing import Any

from fgrecon.core.errors import InvalidInputError
from fgrecon.io.datasets.description import (
    CameraImage,
    DataSequence,
    Moment,
    Reader,
    WorldBox,
    drive_of,
    images_there,
)
from fgrecon.io.kitti_files import Drive, Objects, has_labels, read_drive, read_images

__all__ = [
    "NAMES",
    "CameraImage",
    "DataSequence",
    "Moment",
    "WorldBox",
    "data_set_of",
    "has_drive",
    "is_data_set",
    "open_drive",
    "open_images",
    "open_sequence",
    "open_video",
    "submitted_boxes",
]

NAMES = "nuscenes", "argoverse2", "kitti360", "waymo", "cityscapes3d", "kitti_raw", "zod"
"""The modules that read data sets, in the order in which they are tried."""


def data_set_of(path: Path) -> Reader[Any] | None:
    """What reads a path; None where it is no data set that is known. Heavy packages are imported by who reads."""
    if not path.is_dir():
        return None
    readers: Iterator[Reader[Any]] = (import_module(f"{__name__}.{name}").READER for name in NAMES)
    return next((reader for reader in readers if reader.matches(path)), None)


def is_data_set(source: str | Path) -> bool:
    """Whether a path, with or without what is meant of it, is one of these data sets."""
    return data_set_of(_split(source)[0]) is not None


def open_sequence(source: str | Path) -> tuple[DataSequence, str | None]:
    """A sequence of a data set and the camera that is meant, None where none is named.

    Raises:
        InvalidInputError: It is no data set, has no such sequence or camera, or a file is malformed; names it.
    """
    path, name = _split(source)
    reader = data_set_of(path)
    if reader is None:
        fix = f"Give a folder of one of: {', '.join(NAMES)}."
        raise InvalidInputError("data set", str(path), fix)
    if name is None or name in reader.listed(path):
        return reader.sequence(path, name), None
    sequence, _, camera = name.rpartition("/")
    return reader.sequence(path, sequence or None), camera


def open_drive(source: str | Path) -> Drive:
    """The labelled images of one camera: a drive of KITTI, its object set, or a sequence of a data set.

    Args:
        source: The folder; of a data set with what is meant of it.
    """
    if has_labels(Path(source)) or not is_data_set(source):
        return read_images(Path(source).absolute())
    found, camera = open_sequence(source)
    return drive_of(found, camera)


def open_images(source: str | Path) -> tuple[CameraImage, ...]:
    """The images of a sequence of a data set, or of one of its cameras; those whose files are there."""
    found, camera = open_sequence(source)
    return images_there(found, found.images if camera is None else found.of_camera(camera))


def open_video(source: str | Path) -> Drive:
    """A drive whose images follow one another, of KITTI's tracking set or of a data set; see `open_drive`.

    Raises:
        InvalidInputError: It is none, its images are each by itself, or a file is missing or malformed; names it.
    """
    if not is_data_set(source):
        return read_drive(Path(source).absolute())
    found, camera = open_sequence(source)
    if not found.continuous:
        raise InvalidInputError("drive", str(source), "Give images that follow one another; these are each by itself.")
    return drive_of(found, camera)


def submitted_boxes(path: Path, source: str | Path) -> dict[int, Objects]:
    """The boxes of a submission of nuScenes in the images of a camera, by frame, of the samples that it speaks of.

    Args:
        path: JSON of the detection or the tracking task.
        source: The camera, as `open_drive` takes it.

    Raises:
        InvalidInputError: The source is none of nuScenes, or the file cannot be read or has none of its samples.
    """
    from fgrecon.io.datasets import detections, nuscenes

    if not nuscenes.READER.matches(_split(source)[0]):
        raise InvalidInputError("results", str(path), "Give a camera of nuScenes for boxes of nuScenes.")
    sequence, camera = open_sequence(source)
    frames = drive_of(detections.with_submitted(path, sequence), camera).frames
    return {frame.number: frame.objects for frame in frames if frame.labelled}


def has_drive(source: str | Path) -> bool:
    """Whether `open_drive` reads it."""
    return has_labels(Path(source)) or is_data_set(source)


def _split(source: str | Path) -> tuple[Path, str | None]:
    """Path and what is meant of it; a file may have the sign in its own name."""
    text, sign, name = str(source).rpartition("#")
    return (Path(source), None) if Path(source).exists() or not (sign and name) else (Path(text), name)
