"""`fgrecon evaluate boxes`: 3D boxes of any source against KITTI's labels, several sources side by side."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import takewhile
from pathlib import Path
from typing import Annotated

import typer

from fgrecon.calibration.labelled_drives import check_names
from fgrecon.cli.options import JsonOption
from fgrecon.cli.outputs import check_outputs
from fgrecon.cli.terminal import Terminal
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.text import counted
from fgrecon.io.datasets import has_drive, open_drive, submitted_boxes
from fgrecon.io.datasets.detections import is_submission
from fgrecon.io.kitti_files import Drive, Objects
from fgrecon_research.cli.evaluate.data_options import MarkdownOption
from fgrecon_research.evaluation.boxes3d import read_boxes_of_drives, score
from fgrecon_research.evaluation.boxes_summary import document, precisions_of_drives, summarise, tables


def boxes_command(
    folder: Annotated[
        Path,
        typer.Argument(
            metavar="DRIVE",
            help="Labels: a drive of KITTI's tracking set, its object set's folder, or a data set's camera "
            "(PATH#SEQUENCE/CAMERA); more of them may follow.",
        ),
    ],
    results: Annotated[
        list[str],
        typer.Argument(
            metavar="[NAME=]RESULTS",
            help="Folders of object lines by frame or of `fgrecon run`, or files of tracking lines; of several drives "
            "a folder with one for each, by its name; nuScenes' submissions (json). NAME is what the tables call it.",
        ),
    ],
    terminal: Terminal,
    overlap: Annotated[
        float, typer.Option(min=0.0, max=1.0, help="Overlap in the image above which a box is a labelled vehicle's.")
    ] = 0.5,
    min_score: Annotated[
        float, typer.Option(help="Boxes of a lower score are none; average precision takes all of them.")
    ] = 0.0,
    markdown: MarkdownOption = None,
    json_out: JsonOption = None,
) -> None:
    """Score 3D boxes against labels: overlaps, positions, angles and sizes of labelled vehicles, and average precision.

    Folders with labels at the beginning are drives, scored together; what follows has boxes. The frames are those that
    every source speaks of. Shares are of all labelled vehicles, found or not, errors of those that are found, with
    intervals of 95 % by bootstrap over tracks, of single images over these. Of fewer than 41 labels there is no average
    precision at 40 points (-): even of perfect boxes it would be below 100. --verbose shows every vehicle.

    Exit code 1: no labelled vehicle got a box.
    """
    check_outputs(json_out, markdown)
    screen = terminal.screen(json_out)
    drives, places, texts = _drives(folder, results)
    sources = _sources(texts, drives, places)
    frames = _common_frames(drives, sources)
    spoken_of = [drive for drive in drives if frames[drive.name]]
    scored = {
        name: [
            one
            for drive in spoken_of
            for one in score(drive, boxes[drive.name], frames[drive.name], least=overlap, min_score=min_score)
        ]
        for name, boxes in sources.items()
    }
    if not all(scored.values()):
        raise InvalidInputError("drive", str(folder), "Give labelled cars or vans of at least 25 pixels.")
    curves = {name: precisions_of_drives(spoken_of, boxes, frames) for name, boxes in sources.items()}
    made = tables({name: summarise(vehicles) for name, vehicles in scored.items()}, curves)
    what = counted(sum(map(len, frames.values())), "image")
    screen.print(f"{what}." if len(drives) == 1 else f"{counted(len(spoken_of), 'drive')}, {what}.")
    if silent := [drive.name for drive in drives if not frames[drive.name]]:
        screen.print(f"Left out, since not every source speaks of them: {', '.join(silent)}.")
    screen.print(*(one.shown() for one in made))
    for name, vehicles in scored.items():
        for one in vehicles:
            place = one.frame if len(drives) == 1 else f"{one.drive}/{one.frame}"
            errors = f"{one.metres:.2f} m, {one.degrees:.1f} degrees, IoU {one.overlap:.2f}" if one.found else "no box"
            screen.detail(f"{name} {place}/{one.index} {one.kind}: {errors}")
    screen.write_document(document(scored, curves))
    screen.write_text(markdown, "\n".join(one.markdown() for one in made))
    if not any(one.found for vehicles in scored.values() for one in vehicles):
        screen.fail("No labelled vehicle got a box.")
        raise typer.Exit(1)


def _drives(folder: Path, following: Sequence[str]) -> tuple[list[Drive], list[Path], list[str]]:
    """The drives, where they are, and the texts behind them."""
    more = list(takewhile(has_drive, map(Path, following)))
    if len(more) == len(following):
        raise InvalidInputError("results", "none", "Give boxes behind the drives: [NAME=]RESULTS.")
    places = [folder, *more]
    drives = [open_drive(place) for place in places]
    check_names([drive.name for drive in drives])
    return drives, places, list(following[len(more) :])


def _common_frames(
    drives: Sequence[Drive], sources: Mapping[str, Mapping[str, Mapping[int, Objects]]]
) -> dict[str, list[int]]:
    """The frames of each drive that every source speaks of."""
    frames = {
        drive.name: sorted(set.intersection(*(set(boxes.get(drive.name, ())) for boxes in sources.values())))
        for drive in drives
    }
    if not any(frames.values()):
        raise InvalidInputError("results", ", ".join(sources), "Give sources that speak of the same frames.")
    return frames


def _sources(
    texts: Sequence[str], drives: Sequence[Drive], places: Sequence[Path]
) -> dict[str, dict[str, dict[int, Objects]]]:
    """Boxes by the source's name, the drive's and the frame."""
    sources: dict[str, dict[str, dict[int, Objects]]] = {}
    for text in texts:
        name, named, place = text.partition("=")
        if not named or Path(text).exists():  # a path may have the sign in it
            name, place = Path(text).stem, text
        if name in sources:
            raise InvalidInputError("results", name, "Give each source another name, by NAME=RESULTS.")
        sources[name] = (
            {d.name: submitted_boxes(Path(place), at) for d, at in zip(drives, places, strict=True)}
            if is_submission(Path(place))
            else read_boxes_of_drives(Path(place), drives)
        )
    return sources
