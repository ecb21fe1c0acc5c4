"""`fgrecon evaluate refine`: 3D boxes before and after `fgrecon refine`, against KITTI's labels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from fgrecon.calibration.labelled_drives import read_folds
from fgrecon.cli.commands import option
from fgrecon.cli.options import BoxErrorOptions, FoldOption, JsonOption, SceneOptions, WeightsOption
from fgrecon.cli.outputs import check_outputs
from fgrecon.cli.terminal import Terminal, counting
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.options import BoxModel, BoxOptions, Options
from fgrecon.io.datasets import open_drive, submitted_boxes
from fgrecon.io.datasets.detections import is_submission
from fgrecon.io.kitti_files import Drive, Objects
from fgrecon.perception.keypoints.detect import KeypointCascade
from fgrecon_research.evaluation.boxes3d import read_boxes
from fgrecon_research.evaluation.refined import RefinedVehicle, Refinement, compare, document, refine_drive
from fgrecon_research.evaluation.text_table import TextTable


@dataclass(frozen=True)
class BoxesBefore:
    """The 3D boxes that are refined."""

    boxes: Path | None = option(
        "A detector's boxes of the only drive, as for `evaluate boxes`.",
        metavar="FOLDER|FILE",
        show_default="the labelled ones, disturbed by the errors given",
    )
    min_score: float = option("Boxes of a lower score are none.", default=0.5)
    seed: int = option("Of the errors that labels are disturbed by.", default=0)
    every: int = option("Take every so many of the images that count.", default=1, min=1)

    def of(self, drive: Drive, number: int, place: Path) -> np.random.Generator | dict[int, Objects]:
        """A detector's cars of a drive by frame, or what the labels of the drive of that number are disturbed by."""
        if self.boxes is None:
            return np.random.default_rng([self.seed, number])
        found = (
            submitted_boxes(self.boxes, place)
            if is_submission(self.boxes)
            else read_boxes(self.boxes, [frame.number for frame in drive.frames])
        )
        return {
            frame: one.take(np.array([kind == "Car" for kind in one.kind], dtype=bool) & (one.score >= self.min_score))
            for frame, one in found.items()
        }


def refine_evaluation_command(
    folders: Annotated[
        list[Path],
        typer.Argument(
            metavar="DRIVE",
            help="Labels: drives of KITTI's tracking set, its object set's folder, or a data set's camera.",
        ),
    ],
    scene: SceneOptions,
    errors: BoxErrorOptions,
    before: BoxesBefore,
    terminal: Terminal,
    weights: WeightsOption = None,
    fold: FoldOption = None,
    json_out: JsonOption = None,
) -> None:
    """Score 3D boxes before and after they are refined: position, yaw, heading flips, size, and how many got worse.

    Without --boxes each labelled box is disturbed by the errors that the options say, with a fixed seed. Cars and vans
    count as in `evaluate video`. --verbose shows every vehicle.

    Exit code 1: no box was refined.
    """
    check_outputs(json_out)
    screen = terminal.screen(json_out)
    drives = [open_drive(folder) for folder in folders]
    files = read_folds(fold or (), [drive.name for drive in drives], weights)
    settings = scene.settings(
        Options(strategy=scene.strategy, box=BoxOptions(model=BoxModel.CUBOID), keep_history=False)
    )
    if before.boxes is not None and len(drives) > 1:
        raise InvalidInputError("boxes", str(before.boxes), "Give the one drive that they are of.")
    networks = {file: KeypointCascade(file) for file in dict.fromkeys(files.values())}
    vehicles = []
    with screen.bar() as advance:
        for number, drive in enumerate(drives):
            how = Refinement(networks[files[drive.name]], settings, errors.errors())
            source = before.of(drive, number, folders[number])
            count = counting(advance, drive.name, len(drive.frames) // before.every)
            vehicles += refine_drive(drive, source, how, every=before.every, advance=count)
    if not vehicles:
        raise InvalidInputError("drives", ", ".join(d.name for d in drives), "Give drives with labelled boxes.")
    screen.print(_table(vehicles).shown())
    for one in vehicles:
        screen.detail(f"{one.drive}/{one.frame:06d}/{one.index} {one.kind}: {_change(one)}. {one.message}")
    given = {
        "drives": [drive.name for drive in drives],
        "boxes": "disturbed labels" if before.boxes is None else str(before.boxes),
        "seed": before.seed,
        "every": before.every,
        "networks": {name: "shipped" if file is None else str(file) for name, file in files.items()},
        "box_errors": vars(errors),
        "ground": settings.ground is not None,
    }
    screen.write_document(document(vehicles, given))
    if not any(one.changed for one in vehicles):
        screen.fail("No box was refined.")
        raise typer.Exit(1)


def _change(one: RefinedVehicle) -> str:
    """How far a box is off, before and after."""
    metres, degrees = (one.before.metres, one.after.metres), (one.before.degrees, one.after.degrees)
    return f"{_arrow(metres, '.2f')} m, {_arrow(degrees, '.1f')} degrees"


def _table(vehicles: Sequence[RefinedVehicle]) -> TextTable:
    headings = ("mean m", "median m", "mean °", "median °", "flipped", "l, w, h cm", "> 5 % worse", "worst", "doubled")
    rows = []
    for name, one in compare(vehicles).items():
        sizes = [", ".join(f"{100.0 * value:.0f}" for value in size) for size in one.size]
        cells = [
            *(_arrow(pair, ".2f") for pair in (one.mean_metres, one.median_metres)),
            *(_arrow(pair, ".1f") for pair in (one.mean_degrees, one.median_degrees)),
            *(_arrow(one.flipped, "d"), " -> ".join(sizes), str(one.worse)),
            *(f"{one.worst_metres:+.2f} m, {one.worst_percent:+.1f} %", str(one.doubled), f"{one.spread:.2f}"),
        ]
        rows.append([name, str(one.vehicles), str(one.refined), *cells])
    return TextTable(["before -> after", "boxes", "refined", *headings, "spread"], rows)


def _arrow(pair: Sequence[float], digits: str) -> str:
    return " -> ".join(format(value, digits) for value in pair)
