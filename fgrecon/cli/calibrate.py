"""`fgrecon calibrate`: fit to a detector how far to trust it, from labelled drives."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fgrecon.cli.common import check_output, headed_table
from fgrecon.cli.labelled_drives import DriveOptions, DrivesArgument
from fgrecon.cli.options import LabelledScene
from fgrecon.cli.terminal import Terminal

if TYPE_CHECKING:  # the command line must start fast: what the command needs is imported when it runs
    from fgrecon.cli.labelled_drives import ScoredDrives
    from fgrecon.core.errors import InvalidInputError

__all__ = ["calibrate_command"]

_EDGES = "Where the boxes' edges lie"
_NUMBERS = "How far the network's errors go together, and its facings,"


def calibrate_command(
    folders: DrivesArgument,
    labelled: LabelledScene,
    terminal: Terminal,
    how: DriveOptions,
    out: Annotated[Path, typer.Option(metavar="FILE", help="Where to write it (JSON), for --calibration.")],
) -> None:
    """Fit what results say of themselves to a keypoint network: how far its errors go together, and its facings.

    The network should not have learnt from the drives: --weights names it, --fold one for some of the drives. All boxes
    are reconstructed six times, with regions of six widths. Told is how well what is fitted without a drive holds
    there. --verbose tells each width's shares.

    With --detect it is fitted to vehicles in detected boxes, and so is where the edges of these lie beside the
    outlines, by the cars that are visible as a whole.

    What the drives are too few for is left at its default, and the rest is written. A value at an end of what was
    tried, or that does not hold on drives left out, is warned of; the file has it under provenance (inside, doubts).
    """
    from dataclasses import asdict, replace

    from fgrecon.calibration.box_fit import check_whole_cars, fit_boxes, seen_boxes
    from fgrecon.calibration.detector_fit import FACTORS, as_said, check_labels, check_solved, fit_detector
    from fgrecon.calibration.labelled_boxes import SYSTEM, box_coverage
    from fgrecon.core.coverage import SIGMAS
    from fgrecon.core.detector_calibration import DetectorCalibration
    from fgrecon.core.errors import InvalidInputError
    from fgrecon.io.catalogue import save_calibration
    from fgrecon.io.kitti_drives import read_images

    def score(factor: float) -> ScoredDrives:
        done = how.score(folders, labelled, screen, keypoints=as_said(factor))
        for one in box_coverage(done.boxes, SYSTEM):
            shares = ", ".join(f"{100 * one.inside[level]['claimed']:.0f} in {100 * level:.0f} %" for level in SIGMAS)
            screen.detail(f"Factor {factor:g}: {one.quantity} {shares}.")
        return done

    def leave_out(what: str, error: InvalidInputError) -> None:
        doubts.append(f"{what} could not be fitted: {error.value}. {error.fix}")
        screen.warn(doubts[-1])

    check_output(out)
    screen = terminal.screen()
    doubts: list[str] = []
    drives = [read_images(folder.absolute()) for folder in folders]
    check_labels(drives)
    fits_boxes, source = how.detect, None
    if fits_boxes:
        try:
            check_whole_cars(drives)
        except InvalidInputError as error:
            leave_out(_EDGES, error)
            fits_boxes = False
    done = score(FACTORS[0])
    told = {
        "drives": [drive.name for drive in drives],
        "networks": [{"file": one["file"], "drives": one["drives"]} for one in done.networks()],
        "ground": done.told.origin,
        "size_prior": labelled.size_prior,
        "boxes": how.boxes,
    }
    if fits_boxes:
        seen = list(seen_boxes(drives, done.frames, done.told.scene.prior))
        try:
            source = fit_boxes(seen)
            told["outlines"] = len(seen)
        except InvalidInputError as error:
            leave_out(_EDGES, error)
    calibration, found = DetectorCalibration(provenance=told), None
    try:
        check_solved(done.boxes)
        found = fit_detector({FACTORS[0]: done.boxes} | {f: score(f).boxes for f in FACTORS[1:]}, told)
        calibration = found.calibration
    except InvalidInputError as error:
        if source is None:
            raise
        leave_out(_NUMBERS, error)
    screen.print(done.in_words())
    table = headed_table("fitted", "value")
    fitted = {} if found is None else calibration.numbers
    if source is not None:
        fitted |= {f"boxes.{name}": value for name, value in asdict(source).items()}
    for name, value in fitted.items():
        table.add_row(name, f"{value:.3f}")
    screen.print(table)
    if found is not None and len(drives) > 1:
        held = headed_table("on drives left out of the fit", *(f"inside {100 * level:.0f} %" for level in SIGMAS))
        for quantity, inside in found.inside.items():
            held.add_row(quantity, *(f"{100 * inside[level]:.0f}" for level in SIGMAS))
        screen.print(held, f"The facing's expected calibration error there is {found.facing_error:.3f}.")
    if found is not None:
        doubts += found.doubts
        for doubt in found.doubts:
            screen.warn(doubt)
    provenance = {**calibration.provenance, "doubts": doubts}
    screen.wrote(save_calibration(replace(calibration, boxes=source, provenance=provenance), out))
