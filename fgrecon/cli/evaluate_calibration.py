"""`fgrecon evaluate calibration`: whether regions, facings and statuses hold what they promise, on labelled drives."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fgrecon.cli.common import check_outputs, headed_table
from fgrecon.cli.labelled_drives import DriveOptions, DrivesArgument
from fgrecon.cli.options import JsonOption, LabelledScene
from fgrecon.cli.terminal import Terminal

if TYPE_CHECKING:  # the command line must start fast: what the command needs is imported when it runs
    from rich.table import Table

    from fgrecon.evaluation.calibration import Calibration

__all__ = ["calibration_command"]


def calibration_command(
    folders: DrivesArgument,
    labelled: LabelledScene,
    terminal: Terminal,
    how: DriveOptions,
    track: Annotated[
        bool, typer.Option("--track", help="Also what is said over time: online, and in batch (`fgrecon.Tracker`).")
    ] = False,
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
    from fgrecon.evaluation.calibration import calibrate_boxes, calibration_document
    from fgrecon.evaluation.video_images import SYSTEM
    from fgrecon.evaluation.video_tracks import BATCH, ONLINE

    check_outputs(json_out, picture)
    screen = terminal.screen(json_out)
    scored = how.score(folders, labelled, screen, rivals=(), track=track)
    methods = (SYSTEM, ONLINE, BATCH) if track else (SYSTEM,)
    found = {method: calibrate_boxes(scored.boxes, method) for method in methods}
    screen.print(scored.in_words())
    for method, one in found.items():
        screen.print(_regions_table(method, one), _status_table(method, one), _in_words(one))
    for box in scored.boxes:
        for method in methods:
            outcome = box.outcomes[method]
            told = outcome.failure or f"{outcome.status}, {outcome.degrees:.1f} degrees, {outcome.metres:.2f} m"
            screen.detail(f"{box.drive}/{box.frame:06d}/{box.index} {method}: {told}")
    names = [drive.name for drive in scored.drives]
    given = {"drives": names, "ground": scored.ground, "size_prior": labelled.size_prior}
    documents = [calibration_document(one, {"method": method, **given}) for method, one in found.items()]
    screen.write_json(json.dumps(documents, indent=1, allow_nan=False) + "\n")
    if picture is not None:
        from fgrecon.viz import save_picture
        from fgrecon.viz.calibration_picture import calibration_picture

        screen.wrote(save_picture(picture, calibration_picture(found[SYSTEM].regions, found[SYSTEM].facing)))
    if not found[SYSTEM].statuses:
        screen.fail("No box could be reconstructed.")
        raise typer.Exit(1)


def _regions_table(method: str, found: Calibration) -> Table:
    from fgrecon.core.coverage import SIGMAS

    kinds = ("claimed", "scaled", "constant")
    headings = [f"{kind} {100 * level:.0f} %" for level in SIGMAS for kind in kinds]
    table = headed_table(f"{method}: inside, radius", "results", *headings)
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
    table = headed_table(f"{method}: status", "results", "turned round", "wrong", "wrong %")
    for one in found.statuses:
        table.add_row(one.status, str(one.count), str(one.turned), str(one.wrong), f"{100 * one.wrong / one.count:.1f}")
    return table


def _in_words(found: Calibration) -> str:
    if not len(found.facing.count):
        return "No result has a facing's probability."
    return f"The facing's probability has an expected calibration error of {found.facing.error:.3f}."
