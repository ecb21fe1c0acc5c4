"""`fgrecon evaluate boxes`: 3D boxes of any source against KITTI's labels, several sources side by side."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fgrecon.cli.common import check_outputs, headed_table
from fgrecon.cli.options import JsonOption
from fgrecon.cli.terminal import Terminal
from fgrecon.core.text import counted

if TYPE_CHECKING:  # the command line must start fast: what the command needs is imported when it runs
    from collections.abc import Mapping, Sequence

    from rich.table import Table

    from fgrecon.evaluation.boxes3d import LabelledBox, Precision

__all__ = ["boxes_command"]


def boxes_command(
    folder: Annotated[
        Path,
        typer.Argument(metavar="DRIVE", help="Labels: a drive of KITTI's tracking set, or its object set's folder."),
    ],
    results: Annotated[
        list[str],
        typer.Argument(
            metavar="[NAME=]RESULTS",
            help="Folders of object lines by frame, or files of tracking lines; NAME is what the tables call it.",
        ),
    ],
    terminal: Terminal,
    overlap: Annotated[
        float, typer.Option(min=0.0, max=1.0, help="Overlap in the image above which a box is a labelled vehicle's.")
    ] = 0.5,
    min_score: Annotated[
        float, typer.Option(help="Boxes of a lower score are none; average precision takes all of them.")
    ] = 0.0,
    json_out: JsonOption = None,
) -> None:
    """Score 3D boxes against labels: overlaps, positions, angles and sizes of labelled vehicles, and average precision.

    The frames are those that every source speaks of. Shares are of all labelled vehicles, found or not, with intervals
    of 95 % by bootstrap over tracks, of single images over these. --verbose tells every vehicle.

    Exit code 1: no labelled vehicle got a box.
    """
    from fgrecon.core.errors import InvalidInputError
    from fgrecon.evaluation.boxes3d import document, precisions, read_boxes, score
    from fgrecon.io.kitti_drives import read_images

    check_outputs(json_out)
    screen = terminal.screen(json_out)
    drive = read_images(folder.absolute())
    numbers = [frame.number for frame in drive.frames if frame.labelled]
    sources = {}
    for text in results:
        name, named, place = text.partition("=")
        if not named or Path(text).exists():  # a path may have the sign in it
            name, place = Path(text).stem, text
        path = Path(place)
        if name in sources:
            raise InvalidInputError("results", name, "Give each source another name, by NAME=RESULTS.")
        sources[name] = read_boxes(path, numbers)
    frames = sorted(set(numbers).intersection(*sources.values()))
    if not frames:
        raise InvalidInputError("results", ", ".join(sources), "Give sources that speak of the same frames.")
    scored = {name: score(drive, boxes, frames, least=overlap, min_score=min_score) for name, boxes in sources.items()}
    if not all(scored.values()):
        raise InvalidInputError("drive", str(folder), "Give labelled cars or vans of at least 25 pixels.")
    curves = {name: precisions(drive, boxes, frames) for name, boxes in sources.items()}
    screen.print(f"{counted(len(frames), 'image')}.", _groups(scored), _curves(curves))
    for name, vehicles in scored.items():
        for one in vehicles:
            told = f"{one.metres:.2f} m, {one.degrees:.1f} degrees, IoU {one.overlap:.2f}" if one.found else "no box"
            screen.detail(f"{name} {one.frame}/{one.index} {one.kind}: {told}")
    screen.write_json(json.dumps(document(scored, curves), indent=1, allow_nan=False) + "\n")
    if not any(one.found for vehicles in scored.values() for one in vehicles):
        screen.fail("No labelled vehicle got a box.")
        raise typer.Exit(1)


def _groups(scored: Mapping[str, Sequence[LabelledBox]]) -> Table:
    from fgrecon.core.metrics import THRESHOLDS
    from fgrecon.evaluation.boxes3d import LEAST_OVERLAPS, summarise

    shares = [f"IoU ≥ {least:g} %" for least in LEAST_OVERLAPS] + [f"within {most}° %" for most in THRESHOLDS]
    numbers = ("mean m", "median m", "depth %", "turned %", "l, w, h m")
    table = headed_table("", "source", "labels", "found", *shares, *numbers, left=2, wrap=True)
    summaries = {name: summarise(vehicles) for name, vehicles in scored.items()}
    for group in dict.fromkeys(group for groups in summaries.values() for group in groups):
        for name, groups in summaries.items():
            one = groups[group]
            table.add_row(
                group,
                name,
                str(one.vehicles),
                str(one.found),
                *(share.shown(0) for share in (*one.right, *one.within)),
                "-" if one.mean_metres is None else one.mean_metres.shown(2),
                f"{one.median_metres:.2f}",
                f"{one.depth:+.1f}",
                f"{one.turned:.1f}",
                ", ".join(f"{error:+.2f}" for error in one.size),
            )
    return table


def _curves(curves: Mapping[str, Sequence[Precision]]) -> Table:
    from fgrecon.evaluation.boxes3d import LEAST_OVERLAPS

    places = [f"{space} {least:g}" for space in ("BEV", "3D") for least in LEAST_OVERLAPS]
    table = headed_table("AP at 40 points", "source", "labels", "2D 0.7", "AOS", *places, left=2, wrap=True)
    for i in range(3):
        for name, regimes in curves.items():
            one = regimes[i]
            angle = "-" if one.orientation is None else f"{one.orientation:.1f}"
            shares = [f"{share:.1f}" for share in (*one.ground, *one.volume)]
            table.add_row(f"cars, {one.regime}", name, str(one.labels), f"{one.image:.1f}", angle, *shares)
    return table
