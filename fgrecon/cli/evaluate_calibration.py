"""`fgrecon evaluate calibration`: whether regions, facings and statuses hold what they promise, on labelled drives."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fgrecon.cli.common import check_outputs
from fgrecon.cli.evaluate_video import drive_setups, read_folds
from fgrecon.cli.options import JsonOption, LabelledScene, TogetherOption, WeightsOption
from fgrecon.cli.progress import counting
from fgrecon.cli.terminal import Terminal
from fgrecon.core.choices import BoxModel

if TYPE_CHECKING:  # the command line must start fast: what the command needs is imported when it runs
    from rich.table import Table

    from fgrecon.evaluation.calibration import Calibration

__all__ = ["calibration_command"]


def calibration_command(
    folders: Annotated[
        list[Path],
        typer.Argument(
            metavar="DRIVE", help="Folders with image_02, calib.txt and label_02.txt of KITTI's tracking set."
        ),
    ],
    labelled: LabelledScene,
    terminal: Terminal,
    weights: WeightsOption = None,
    fold: Annotated[
        list[str] | None,
        typer.Option(
            metavar="DRIVE[,DRIVE...]=FILE",
            help="Keypoint network for these drives, such as one that was trained without them; repeat for more.",
        ),
    ] = None,
    box_model: Annotated[BoxModel, typer.Option(help="What the 2D boxes enclose.")] = BoxModel.CUBOID,
    together: TogetherOption = True,
    track: Annotated[
        bool, typer.Option("--track", help="Also what is said over time: online, and in batch (`fgrecon.Tracker`).")
    ] = False,
    jobs: Annotated[int, typer.Option(min=1, help="Processes.")] = 1,
    picture: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Coverage and reliability diagrams (png, svg, pdf, jpg).")
    ] = None,
    json_out: JsonOption = None,
) -> None:
    """Compare what results say of themselves with labels: regions, the facing's probability, and the status.

    A region of 68 or 95 % should hold so many errors, and be no wider than one that is made to hold: by scaling the
    covariances, or of one size for all, with the drive left out of the fit. Vehicles turned round count for the facing
    alone. Wrong are results more than 15 degrees or 20 % of the distance off. --verbose tells every box.

    Exit code 1: no box could be reconstructed.
    """
    from fgrecon.core.errors import InvalidInputError
    from fgrecon.core.options import Options
    from fgrecon.evaluation.calibration import calibrate_boxes, calibration_document
    from fgrecon.evaluation.video_images import SYSTEM, score_drives, wanted
    from fgrecon.evaluation.video_tracks import BATCH, ONLINE, follow_boxes
    from fgrecon.io.kitti_drives import read_drive

    check_outputs(json_out, picture)
    screen = terminal.screen(json_out)
    drives = [read_drive(folder.absolute()) for folder in folders]
    files = read_folds(fold or (), [drive.name for drive in drives], weights)
    frames = sum(len(wanted(frame)) > 0 for drive in drives for frame in drive.frames)
    if not frames:
        fix = "Give drives with labelled cars or vans of at least 25 pixels."
        raise InvalidInputError("drives", ", ".join(drive.name for drive in drives), fix)
    scene, (_, origin) = labelled.scene(), labelled.plane()
    setups = drive_setups(files, scene, Options(box=box_model), together=together)
    with screen.bar() as advance:
        watched = counting(advance, "Images", frames)
        boxes = score_drives(drives, setups, scene, rivals=(), jobs=jobs, advance=watched)
        if track:
            boxes = follow_boxes(boxes, drives, setups)
    methods = (SYSTEM, ONLINE, BATCH) if track else (SYSTEM,)
    found = {method: calibrate_boxes(boxes, method) for method in methods}
    screen.print(f"{len(drives)} drives, {frames} images, {len(boxes)} boxes; {origin}.")
    for method, one in found.items():
        screen.print(_regions_table(method, one), _status_table(method, one), _in_words(one))
    for box in boxes:
        for method in methods:
            got = box.outcomes[method]
            told = got.failure or f"{got.status}, {got.degrees:.1f} degrees, {got.metres:.2f} m"
            screen.detail(f"{box.drive}/{box.frame:06d}/{box.index} {method}: {told}")
    given = {"drives": [drive.name for drive in drives], "ground": origin, "size_prior": labelled.size_prior}
    documents = [calibration_document(one, {"method": method, **given}) for method, one in found.items()]
    screen.write_json(json.dumps(documents, indent=1, allow_nan=False) + "\n")
    if picture is not None:
        from fgrecon.viz import save_picture
        from fgrecon.viz.calibration_picture import calibration_picture

        screen.wrote(save_picture(picture, calibration_picture(found[SYSTEM].regions, found[SYSTEM].facing)))
    if not found[SYSTEM].statuses:
        screen.fail("No box could be reconstructed.")
        raise typer.Exit(1)


def _table(*headings: str) -> Table:
    from rich.box import SIMPLE_HEAD
    from rich.table import Table

    table = Table(box=SIMPLE_HEAD, pad_edge=False)
    for number, heading in enumerate(headings):
        table.add_column(heading, justify="right" if number else "left", no_wrap=True)
    return table


def _regions_table(method: str, found: Calibration) -> Table:
    from fgrecon.core.coverage import SIGMAS

    kinds = ("claimed", "scaled", "constant")
    headings = [f"{kind} {100 * level:.0f} %" for level in SIGMAS for kind in kinds]
    table = _table(f"{method}: inside, radius", "results", *headings)
    units = {"yaw": "°"}
    for one in found.regions:
        unit = units.get(one.quantity, " m")
        cells = [
            f"{100 * one.inside[level][kind]:.0f}, {one.width[level][kind]:.2f}{unit}"
            for level in SIGMAS
            for kind in kinds
        ]
        table.add_row(one.quantity, str(one.count), *cells)
    return table


def _status_table(method: str, found: Calibration) -> Table:
    table = _table(f"{method}: status", "results", "turned round", "wrong", "wrong %")
    for one in found.statuses:
        table.add_row(one.status, str(one.count), str(one.turned), str(one.wrong), f"{100 * one.wrong / one.count:.1f}")
    return table


def _in_words(found: Calibration) -> str:
    if not len(found.facing.count):
        return "No result has a facing's probability."
    return f"The facing's probability has an expected calibration error of {found.facing.error:.3f}."
