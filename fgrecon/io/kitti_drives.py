"""Images of KITTI with labelled objects, and which objects are one: drives, and folders of single images.

A drive is a folder with `image_02/FFFFFF.jpg` (or png), `calib.txt`, and `label_02.txt` in the format of KITTI's
tracking set: frame and number of the track, then the columns of an object label. Two files may stand beside them:
`clean_tracks.json` names, for each track (`"NUMBER KIND"`), the frames in which it can be used, and
`object_frames.json` the only frames that are labelled at all.

A folder of single images has the layout of KITTI's object set: `image_2`, `label_2` and `calib`, with a file for each
image. There every object is a track of its own.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.camera import MIN_DEPTH
from fgrecon.core.errors import InvalidInputError
from fgrecon.io.json_fields import read_json
from fgrecon.io.kitti_calibration import KittiCalibration, read_calibration
from fgrecon.io.kitti_files import Objects, TrackedObjects, parse_object, read_tracking
from fgrecon.io.text_lines import filled_lines

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
        folder: With its images, labels and calibration.
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
