"""`fgrecon evaluate calibration`: whether regions, facings and statuses hold what they promise, on labelled drives."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from fgrecon.calibration.labelled_boxes import SYSTEM
from fgrecon.cli.options import DriveOptions, DrivesArgument, JsonOption, LabelledScene
from fgrecon.cli.outputs import check_outputs
from fgrecon.cli.terminal import Terminal
from fgrecon.core.coverage import SIGMAS
from fgrecon.core.errors import InvalidInputError
from fgrecon.viz import save_picture
from fgrecon_research.cli.evaluate.followed_drives import Following, score_drives
from fgrecon_research.evaluation.calibration import (
    Calibration,
    calibrate,
    calibrate_boxes,
    calibration_document,
    judge_simulated,
)
from fgrecon_research.evaluation.text_table import TextTable
from fgrecon_research.evaluation.video_tracks import BATCH, ONLINE
from fgrecon_research.viz.calibration_picture import calibration_picture

_SIMULATION = "simulation"


def calibration_command(
    labelled: LabelledScene,
    terminal: Terminal,
    how: DriveOptions,
    folders: DrivesArgument = [],  # noqa: B006  # Typer makes a list of its own
    simulated: Annotated[
        int, typer.Option(min=0, metavar="N", help="Also so many simulated cars, whose 3D keypoints are known.")
    ] = 0,
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
    covariances, or of one size for all, with the drive (of simulated cars a tenth) left out of the fit. Heading flips
    count for the facing alone. Wrong are results more than 15 degrees or 20 % of the distance off. With
    --detect a labelled box is judged by the detected one that overlaps it most, by more than half. --verbose shows
    every box.

    Exit code 1: no vehicle could be reconstructed.
    """
    check_outputs(json_out, picture=picture)
    screen = terminal.screen(json_out)
    if not folders and not simulated:
        raise InvalidInputError("drives", "none", "Give folders of labelled drives, or --simulated N.")
    if how.detect and not folders:
        raise InvalidInputError("detect", "without drives", "Give folders of labelled drives, in which to find cars.")
    known = labelled.given()
    given: dict[str, Any] = {"ground": known.origin, "size_prior": labelled.size_prior}
    found: dict[str, Calibration] = {}
    if folders:
        scored = score_drives(how, folders, labelled, screen, following=Following(track, estimate_motion=False))
        given |= {"drives": [drive.name for drive in scored.drives], "traffic": how.traffic}
        given |= {"boxes": scored.request.boxes, "box_model": scored.request.encloses.value}
        methods = (SYSTEM, ONLINE, BATCH) if track else (SYSTEM,)
        found |= {method: calibrate_boxes(scored.boxes, method) for method in methods}
        screen.print(scored.in_words())
        for box in scored.boxes:
            for method in methods:
                outcome = box.outcomes[method]
                errors = outcome.failure or f"{outcome.status}, {outcome.degrees:.1f} degrees, {outcome.metres:.2f} m"
                screen.detail(f"{box.drive}/{box.frame:06d}/{box.index} {method}: {errors}")
    if simulated:
        cars = judge_simulated(simulated, known.scene.prior, ground=known.ground, size_prior=known.size)
        with screen.bar() as advance:
            judged = []
            for done, car in enumerate(cars, 1):
                judged += [] if car is None else [car]
                advance("Simulated cars", done, simulated)
        found[_SIMULATION] = calibrate(judged)
    for method, one in found.items():
        made = [*calibration_tables(method, one), _acceptance_table(method, one)]
        screen.print(*(table.shown() for table in made), _in_words(one))
    documents = [calibration_document(one, {"method": method, **given}) for method, one in found.items()]
    screen.write_document(documents)
    first = next(iter(found.values()))
    if picture is not None:
        screen.wrote(save_picture(picture, calibration_picture(first.regions, first.facing)))
    if not first.statuses:
        screen.fail("No vehicle could be reconstructed.")
        raise typer.Exit(1)


def calibration_tables(method: str, found: Calibration) -> list[TextTable]:
    """Regions of each quantity, and statuses: how many hold what they promise."""
    kinds = ("claimed", "scaled", "constant")
    heads = [f"{kind} {100 * level:.0f} %" for level in SIGMAS for kind in kinds]
    units = {"yaw": "°", "velocity": " m/s"}
    regions = []
    for one in found.regions:
        unit = units.get(one.quantity, " m")
        cells = [
            f"{100 * one.inside[level][kind]:.0f}, {one.width[level][kind]:.2f}{unit}"
            for level in SIGMAS
            for kind in kinds
        ]
        regions.append([one.quantity, str(one.count), *cells])
    statuses = [
        [one.status, str(one.count), str(one.flipped), str(one.wrong), f"{100 * one.wrong / one.count:.1f}"]
        for one in found.statuses
    ]
    return [
        TextTable([f"{method}: inside, radius", "results", *heads], regions),
        TextTable([f"{method}: status", "results", "flipped", "wrong", "wrong %"], statuses),
    ]


def _acceptance_table(method: str, found: Calibration) -> TextTable:
    """What it costs and brings to take settled results alone whose facing has some probability at least."""
    heads = [f"{method}: facing at least", "flipped, refused", "right, refused", "converged", "flipped"]
    rows = [
        [
            f"{one.least:g}",
            f"{one.flipped_refused} of {one.flipped}",
            f"{one.right_refused} of {one.right} ({100 * one.right_refused / max(one.right, 1):.1f} %)",
            str(one.sure),
            f"{one.sure_flipped} ({100 * one.sure_flipped / max(one.sure, 1):.1f} %)",
        ]
        for one in found.acceptance
    ]
    return TextTable(heads, rows)


def _in_words(found: Calibration) -> str:
    if not len(found.facing.count):
        return "No result has a facing's probability."
    return f"The facing's probability has an expected calibration error of {found.facing.error:.3f}."
