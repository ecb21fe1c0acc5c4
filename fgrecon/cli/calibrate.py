"""`fgrecon calibrate`: fit to a detector how far to trust it, from labelled drives."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from fgrecon.cli.common import check_output, headed_table
from fgrecon.cli.labelled_drives import DriveOptions, DrivesArgument
from fgrecon.cli.options import LabelledScene
from fgrecon.cli.terminal import Terminal

__all__ = ["calibrate_command"]


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
    """
    from dataclasses import asdict, replace

    from fgrecon.core.coverage import SIGMAS
    from fgrecon.evaluation.box_fit import fit_boxes, seen_boxes
    from fgrecon.evaluation.calibration import calibrate_boxes
    from fgrecon.evaluation.detector_fit import FACTORS, as_said, fit_detector
    from fgrecon.evaluation.video_images import SYSTEM
    from fgrecon.io.detector_calibration import save_calibration

    check_output(out)
    screen = terminal.screen()
    scored = {}
    for factor in FACTORS:
        done = how.score(folders, labelled, screen, rivals=(), track=False, keypoints=as_said(factor))
        scored[factor] = done.boxes
        for one in calibrate_boxes(done.boxes, SYSTEM).regions:
            shares = ", ".join(f"{100 * one.inside[level]['claimed']:.0f} in {100 * level:.0f} %" for level in SIGMAS)
            screen.detail(f"Factor {factor:g}: {one.quantity} {shares}.")
    told = {
        "drives": [drive.name for drive in done.drives],
        "networks": [{"file": one["file"], "drives": one["drives"]} for one in done.networks()],
        "ground": done.told.origin,
        "size_prior": labelled.size_prior,
        "boxes": how.boxes,
    }
    found = fit_detector(scored, told)
    calibration = found.calibration
    if how.detect:
        seen = list(seen_boxes(done.drives, done.frames, done.told.scene.prior))
        source = fit_boxes(seen)
        calibration = replace(calibration, boxes=source, provenance={**calibration.provenance, "outlines": len(seen)})
    screen.print(done.in_words())
    table = headed_table("fitted", "value")
    for name, value in calibration.numbers.items():
        table.add_row(name, f"{value:.3f}")
    for name, value in {} if calibration.boxes is None else asdict(calibration.boxes).items():
        table.add_row(f"boxes.{name}", f"{value:.3f}")
    screen.print(table)
    if len(done.drives) > 1:
        held = headed_table("on drives left out of the fit", *(f"inside {100 * level:.0f} %" for level in SIGMAS))
        for quantity, inside in found.inside.items():
            held.add_row(quantity, *(f"{100 * inside[level]:.0f}" for level in SIGMAS))
        screen.print(held, f"The facing's expected calibration error there is {found.facing_error:.3f}.")
    if found.facing_is_default:
        few = "Too few vehicles are turned round" if found.turned else "No vehicle is turned round"
        screen.print(f"{few}: the facing's numbers are the default ones.")
    screen.wrote(save_calibration(calibration, out))
