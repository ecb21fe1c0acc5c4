"""Labelled drives as evaluation commands take them: which network sees each, and what it finds in their boxes.

Where no vehicle is followed, a folder of single images is as good as a drive.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from fgrecon.cli.options import LabelledScene, TogetherOption, Told, TrafficOption, WeightsOption
from fgrecon.cli.progress import counting
from fgrecon.core.choices import BoxModel
from fgrecon.core.text import counted

if TYPE_CHECKING:  # the command line must start fast: what the commands need is imported when they run
    from fgrecon.calibration.labelled_boxes import VideoBox
    from fgrecon.calibration.labelled_frames import Rivals, ScoredFrame
    from fgrecon.calibration.setup import SceneKnowledge, Setup
    from fgrecon.cli.terminal import Screen
    from fgrecon.core.options import KeypointOptions
    from fgrecon.io.kitti_drives import Drive

__all__ = ["DriveOptions", "DrivesArgument", "FoldOption", "ScoredDrives", "check_names", "read_folds"]

DrivesArgument = Annotated[
    list[Path],
    typer.Argument(
        metavar="DRIVE",
        help="Folders with image_02, calib.txt and label_02.txt of KITTI's tracking set; where nothing is followed "
        "also with image_2, calib and label_2 of its object set.",
    ),
]
FoldOption = Annotated[
    list[str] | None,
    typer.Option(
        metavar="DRIVE[,DRIVE...]=FILE",
        help="Keypoint network for these drives, such as one that was trained without them; repeat for more.",
    ),
]


@dataclass(frozen=True)
class ScoredDrives:
    """Drives whose labelled boxes were reconstructed and scored.

    Attributes:
        drives: The drives.
        files: Which file has the network of each, by the drive's name; None for the shipped one.
        setups: What each was reconstructed with, by its name.
        told: What was told.
        images: How many images were looked at: those with a box that counts, or all where vehicles were detected.
        boxes: Those boxes, as far as they were found.
        missed: How many were not.
        frames: What was looked at in each image.
    """

    drives: list[Drive]
    files: dict[str, Path | None]
    setups: dict[str, Setup]
    told: Told
    images: int
    boxes: list[VideoBox]
    missed: int = 0
    frames: Sequence[ScoredFrame] = ()

    def in_words(self) -> str:
        """How much it is, and on which ground."""
        missed = f", {self.missed} more not found" if self.missed else ""
        drives, images = counted(len(self.drives), "drive"), counted(self.images, "image")
        return f"{drives}, {images}, {counted(len(self.boxes), 'box', 'boxes')}{missed}; {self.told.origin}."

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


@dataclass(frozen=True)
class DriveOptions:
    """How labelled drives are reconstructed."""

    weights: WeightsOption = None
    fold: FoldOption = None
    box_model: Annotated[
        BoxModel | None, typer.Option(help="What the 2D boxes enclose.", show_default="cuboid; detected for --detect")
    ] = None
    together: TogetherOption = True
    traffic: TrafficOption = None
    detect: Annotated[
        bool,
        typer.Option(
            "--detect", help="Look at the boxes of the shipped vehicle detector instead of the labelled ones."
        ),
    ] = False
    jobs: Annotated[int, typer.Option(min=1, help="Processes.")] = 1

    @property
    def boxes(self) -> str:
        """Whose the boxes are, in a word."""
        return "detected" if self.detect else "labelled"

    @property
    def encloses(self) -> BoxModel:
        """What the boxes enclose."""
        return self.box_model or (BoxModel.DETECTED if self.detect else BoxModel.CUBOID)

    def score(
        self,
        folders: Sequence[Path],
        labelled: LabelledScene,
        screen: Screen,
        *,
        read: Callable[[Path], Drive] | None = None,
        rivals: Callable[[SceneKnowledge], Callable[[], Rivals]] | None = None,
        keypoints: KeypointOptions | None = None,
    ) -> ScoredDrives:
        """Reconstruct the labelled boxes that count, and score them.

        Args:
            folders: Of the drives.
            labelled: What is told.
            screen: Where progress is shown.
            read: Reads a drive; None to read folders of single images as well.
            rivals: From what is told what scores other methods on the same keypoints.
            keypoints: What is assumed of the detector; None for the default.

        Raises:
            InvalidInputError: A folder is no drive, no box counts or is found, or a network is given for none of the
                drives.
        """
        from fgrecon.calibration.labelled_boxes import wanted
        from fgrecon.calibration.labelled_frames import looks_at, score_frames
        from fgrecon.core.errors import InvalidInputError
        from fgrecon.core.options import Options
        from fgrecon.io.kitti_drives import read_images

        drives = [(read or read_images)(folder.absolute()) for folder in folders]
        files = read_folds(self.fold or (), [drive.name for drive in drives], self.weights)
        if not any(len(wanted(frame)) for drive in drives for frame in drive.frames):
            fix = "Give drives with labelled cars or vans of at least 25 pixels."
            raise InvalidInputError("drives", ", ".join(drive.name for drive in drives), fix)
        told = labelled.told()
        options = Options(box=self.encloses, keypoints=keypoints, traffic=self.traffic)
        setups = _setups(files, told, options, together=self.together, detect=self.detect)
        images = sum(len(looks_at(drive, setups[drive.name])) for drive in drives)
        with screen.bar() as advance:
            watched = counting(advance, "Images", images)
            others = None if rivals is None else rivals(told.scene)
            frames = score_frames(drives, setups, rivals=others, jobs=self.jobs, advance=watched)
        boxes = [box for frame in frames for box in frame.boxes]
        if not boxes:
            fix = "Give drives with vehicles that the detector finds."
            raise InvalidInputError("drives", ", ".join(setups), fix)
        missed = sum(frame.missed for frame in frames)
        return ScoredDrives(drives, files, setups, told, images, boxes, missed, frames)


def check_names(drives: Sequence[str]) -> None:
    """Refuse drives of which two have one name.

    Raises:
        InvalidInputError: Two have.
    """
    from fgrecon.core.errors import InvalidInputError

    twice = [name for number, name in enumerate(drives) if name in drives[:number]]
    if twice:
        raise InvalidInputError("drives", twice[0], "Give each drive once; their folders need different names.")


def read_folds(folds: Sequence[str], drives: Sequence[str], weights: Path | None) -> dict[str, Path | None]:
    """Which file has the network that scores each drive, by the drive's name; None for the shipped one.

    Args:
        folds: `DRIVE[,DRIVE...]=FILE` each.
        drives: Names of all drives.
        weights: File for the drives that no fold names, or None.

    Raises:
        InvalidInputError: Two drives have one name, or a fold names none, one that is not there, or one of another.
    """
    from fgrecon.core.errors import InvalidInputError

    check_names(drives)
    found: dict[str, Path | None] = {}
    for text in folds:
        names, _, file = text.partition("=")
        if not names or not file:
            raise InvalidInputError("fold", text, "Give DRIVE[,DRIVE...]=FILE.")
        for name in names.split(","):
            if name not in drives:
                raise InvalidInputError("fold", name, f"Name one of the drives: {', '.join(drives)}.")
            if name in found:
                raise InvalidInputError("fold", name, "Name each drive in one fold.")
            found[name] = Path(file)
    return {name: found.get(name, weights) for name in drives}


def _setups(
    files: dict[str, Path | None], told: Told, options: Any, *, together: bool, detect: bool
) -> dict[str, Setup]:
    """What each drive is reconstructed with, by its name; each network is loaded once."""
    from fgrecon.calibration.setup import Setup
    from fgrecon.perception.keypoints.detect import KeypointCascade
    from fgrecon.perception.vehicles import NanodetVehicleDetector

    vehicles = NanodetVehicleDetector() if detect else None
    made = {
        file: Setup(
            detector=KeypointCascade(file),
            prior=told.scene.prior,
            ground=told.ground,
            size_prior=told.size,
            options=options,
            together=together,
            vehicles=vehicles,
        )
        for file in dict.fromkeys(files.values())
    }
    return {name: made[file] for name, file in files.items()}
