"""`fgrecon calibrate`: fit to a detector how far to trust it, from labelled drives."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fgrecon.cli.options import DriveOptions, DrivesArgument, LabelledScene
from fgrecon.cli.terminal import Terminal, headed_table

if TYPE_CHECKING:  # the command line must start fast: what the command needs is imported when it runs
    from fgrecon.calibration.labelled_drives import ScoredDrives


def calibrate_command(
    folders: DrivesArgument,
    labelled: LabelledScene,
    terminal: Terminal,
    how: DriveOptions,
    out: Annotated[Path, typer.Option(metavar="FILE", help="Where to write it (JSON), for --calibration.")],
) -> None:
    """Fit what results say of themselves to a keypoint network: how far its errors go together, and its facings.

    The network should not have learnt from the drives: --weights names it, --fold one for some of the drives. All boxes
    are reconstructed six times, with regions of six widths. The output says how well what is fitted without a
    drive holds there. --verbose has each width's shares.

    With --detect it is fitted to vehicles in detected boxes, and so is where the edges of these are beside the
    outlines, by the cars that are visible as a whole.

    What the drives are too few for is left at its default, and the rest is written. A value at an end of what was
    tried, or that does not hold on drives left out, is warned of; the file has it under provenance (inside, warnings).
    """
    from fgrecon.calibration.calibrate import calibrate_detector
    from fgrecon.calibration.labelled_boxes import box_coverage
    from fgrecon.core.coverage import SIGMAS
    from fgrecon.io.catalogue import save_calibration
    from fgrecon.io.files import check_output

    def scored(factor: float, done: ScoredDrives) -> None:
        for coverage in box_coverage(done.boxes):
            inside = ((level, coverage.inside[level]["claimed"]) for level in SIGMAS)
            shares = ", ".join(f"{100 * share:.0f} in {100 * level:.0f} %" for level, share in inside)
            screen.detail(f"Factor {factor:g}: {coverage.quantity} {shares}.")

    check_output(out)
    screen = terminal.screen()
    request = how.request(folders, labelled)
    with screen.bar() as advance:
        found = calibrate_detector(
            request, size_prior=labelled.size_prior, warn=screen.warn, advance=advance, scored=scored
        )
    screen.print(found.scored.in_words())
    table = headed_table("fitted", "value")
    for name, value in found.numbers.items():
        table.add_row(name, f"{value:.3f}")
    screen.print(table)
    if found.fitted is not None and len(found.scored.drives) > 1:
        held = headed_table("on drives left out of the fit", *(f"inside {100 * level:.0f} %" for level in SIGMAS))
        for quantity, inside in found.fitted.inside.items():
            held.add_row(quantity, *(f"{100 * inside[level]:.0f}" for level in SIGMAS))
        screen.print(held, f"The facing's expected calibration error there is {found.fitted.facing_error:.3f}.")
    screen.wrote(save_calibration(found.calibration, out))
