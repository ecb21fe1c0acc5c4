"""Labelled drives reconstructed and scored: the network that scores each, and the outcomes of their boxes.

Where no vehicle is followed, a folder of single images is as good as a drive.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from typing import Any

from fgrecon.calibration.labelled_boxes import VideoBox, wanted
from fgrecon.calibration.labelled_frames import (
    Rivals,
    SceneKnowledge,
    ScoredFrame,
    Setup,
    frames_to_score,
    score_frames,
)
from fgrecon.core.camera import Ground
from fgrecon.core.choices import BoxModel, ClassSource, TrafficSide
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.options import KeypointOptions, Options
from fgrecon.core.size_prior import SizePrior
from fgrecon.core.text import counted
from fgrecon.io.datasets import open_drive
from fgrecon.io.kitti_files import Drive
from fgrecon.perception.keypoints.detect import KeypointCascade
from fgrecon.perception.vehicles import NanodetVehicleDetector

Advance = Callable[[str, float, float | None, str], None]
"""Called with a step, how much of it is done, of how much, and what was done last."""


@dataclass(frozen=True)
class GivenScene:
    """What is given to the whole system of images with known poses."""

    # what is given to rivals whose names ask for it: KITTI's ground and fleet where the system has none
    scene: SceneKnowledge
    ground: Ground | None  # ground plane, or None
    size: SizePrior | None  # size of the fleet, or None
    origin: str  # in words where the ground plane comes from


@dataclass(frozen=True)
class DriveRequest:
    """Which drives are scored, and how they are reconstructed."""

    folders: Sequence[Path]  # of the drives
    given: GivenScene  # what is known of the scene
    weights: Path | None = None  # keypoint network of the drives that no fold names; None for the shipped one
    folds: Sequence[str] = ()  # `DRIVE[,DRIVE...]=FILE` each: the network of these drives
    box_model: BoxModel | None = None  # what the 2D boxes enclose; None for what their source says
    together: bool = True  # whether the vehicles of an image share its ground
    traffic: TrafficSide | None = None  # side of the road that traffic keeps to, or None
    detect: bool = False  # whether the boxes are those of the shipped vehicle detector instead of the labelled ones
    classes: ClassSource | None = None  # who says of which class the vehicles are, or None
    jobs: int = 1  # processes

    @property
    def boxes(self) -> str:
        """Whose the boxes are, in a word."""
        return "detected" if self.detect else "labelled"

    @property
    def encloses(self) -> BoxModel:
        """What the boxes enclose."""
        return self.box_model or (BoxModel.DETECTED if self.detect else BoxModel.CUBOID)


@dataclass(frozen=True)
class ScoredDrives:
    """Drives whose labelled boxes were reconstructed and scored."""

    request: DriveRequest  # what was requested
    drives: list[Drive]
    files: dict[str, Path | None]  # which file has the network of each, by the drive's name; None for the shipped one
    setups: dict[str, Setup]  # what each was reconstructed with, by its name
    images: int  # how many images were looked at: those with a box that counts, or all where vehicles were detected
    boxes: list[VideoBox]  # those boxes, as far as they were detected
    missed: int = 0  # how many were not
    frames: Sequence[ScoredFrame] = ()  # what was observed in each image

    def in_words(self) -> str:
        """How much it is, and on which ground."""
        missed = f", {self.missed} more not found" if self.missed else ""
        drives, images = counted(len(self.drives), "drive"), counted(self.images, "image")
        return f"{drives}, {images}, {counted(len(self.boxes), 'box', 'boxes')}{missed}; {self.request.given.origin}."

    def networks(self) -> list[dict[str, Any]]:
        """Of each network its file, the drives that it scored, and what it has learnt from."""
        drives: dict[Path | None, list[str]] = {}
        for name, file in self.files.items():
            drives.setdefault(file, []).append(name)
        return [
            {
                "file": "shipped" if file is None else str(file),
                "drives": names,
                "provenance": self.setups[names[0]].detector.provenance,
            }
            for file, names in drives.items()
        ]


def score_drives(
    request: DriveRequest,
    advance: Advance,
    *,
    read: Callable[[Path], Drive] = open_drive,
    rivals: Callable[[SceneKnowledge], Callable[[], Rivals]] | None = None,
    keypoints: KeypointOptions | None = None,
) -> ScoredDrives:
    """Reconstruct the labelled boxes that count, and score them.

    Args:
        read: Reads a drive; the default reads folders of single images and data sets as well.
        rivals: From the given scene what scores other methods on the same keypoints.
        keypoints: What is assumed of the detector; None for the default.

    Raises:
        InvalidInputError: A folder is no drive, no box counts or is detected, or a network is given for none of the
            drives.
    """
    drives = [read(folder) for folder in request.folders]
    files = read_folds(request.folds, [drive.name for drive in drives], request.weights)
    if not any(len(wanted(frame)) for drive in drives for frame in drive.frames):
        fix = "Give drives with labelled cars or vans of at least 25 pixels."
        raise InvalidInputError("drives", ", ".join(drive.name for drive in drives), fix)
    setups = _setups(request, files, Options(box=request.encloses, keypoints=keypoints, traffic=request.traffic))
    images = sum(len(frames_to_score(drive, setups[drive.name])) for drive in drives)
    others, done = None if rivals is None else rivals(request.given.scene), count(1)
    frames = score_frames(
        drives,
        setups,
        rivals=others,
        jobs=request.jobs,
        advance=lambda name: advance("Images", next(done), images, name),
    )
    boxes = [box for frame in frames for box in frame.boxes]
    if not boxes:
        fix = "Give drives with vehicles that the detector finds."
        raise InvalidInputError("drives", ", ".join(setups), fix)
    missed = sum(frame.missed for frame in frames)
    return ScoredDrives(request, drives, files, setups, images, boxes, missed, frames)


def check_names(drives: Sequence[str]) -> None:
    """Refuse drives of which two have the same name."""
    twice = [name for number, name in enumerate(drives) if name in drives[:number]]
    if twice:
        raise InvalidInputError("drives", twice[0], "Give each drive once; their folders need different names.")


def read_folds(folds: Sequence[str], drives: Sequence[str], weights: Path | None) -> dict[str, Path | None]:
    """Which file has the network that scores each drive, by the drive's name; None for the shipped one.

    Args:
        folds: `DRIVE[,DRIVE...]=FILE` each.
        weights: File for the drives that no fold names, or None.

    Raises:
        InvalidInputError: Two drives have the same name, or a fold names none, an unknown one, or one of another.
    """
    check_names(drives)
    files: dict[str, Path | None] = {}
    for text in folds:
        names, _, file = text.partition("=")
        if not names or not file:
            raise InvalidInputError("fold", text, "Give DRIVE[,DRIVE...]=FILE.")
        for name in names.split(","):
            if name not in drives:
                raise InvalidInputError("fold", name, f"Name one of the drives: {', '.join(drives)}.")
            if name in files:
                raise InvalidInputError("fold", name, "Name each drive in one fold.")
            files[name] = Path(file)
    return {name: files.get(name, weights) for name in drives}


def _setups(request: DriveRequest, files: dict[str, Path | None], options: Options) -> dict[str, Setup]:
    """What each drive is reconstructed with, by its name; each network is loaded once."""
    detector = NanodetVehicleDetector() if request.detect or request.classes is ClassSource.DETECTED else None
    made = {
        file: Setup(
            detector=KeypointCascade(file),
            prior=request.given.scene.prior,
            ground=request.given.ground,
            size_prior=request.given.size,
            options=options,
            together=request.together,
            vehicles=detector if request.detect else None,
            classes=request.classes,
            classifier=detector,
        )
        for file in dict.fromkeys(files.values())
    }
    return {name: made[file] for name, file in files.items()}
