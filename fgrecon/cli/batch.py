"""`fgrecon batch`: vehicles by the thousand, from files into a folder of Parquet."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fgrecon.cli.commands import option
from fgrecon.cli.options import (
    BOX_MODEL_HELP,
    CameraOptions,
    ClassesOption,
    MinScoreOption,
    NamesOption,
    ScaleOption,
    SceneOptions,
    WeightsOption,
)
from fgrecon.cli.sensor_options import SensorOptions
from fgrecon.cli.terminal import Screen, Terminal, compact_table
from fgrecon.core.choices import BoxModel

if TYPE_CHECKING:  # the command line must start fast: what the command needs is imported when it runs
    from fgrecon.batch import Tally

_LISTED = 3
"""Errors that are listed where nothing could be reconstructed."""


@dataclass(frozen=True)
class BatchOptions:
    """What the rows hold, and who works on them."""

    box_model: BoxModel = option(
        BOX_MODEL_HELP,
        default=BoxModel.SURFACE,
        show_default="surface; as --boxes says; detected where the detector finds them",
    )
    names: NamesOption = None
    boxes: Path | None = option(
        "Boxes of the images' cars: COCO, KITTI, CSV, a file for each image (YOLO); else the detector looks.",
        metavar="FILE|FOLDER",
    )
    min_score: MinScoreOption = None
    classes: ClassesOption = None
    table: Path | None = option("Also write all rows as one table (csv, parquet).", metavar="FILE")
    weights: WeightsOption = None
    scale_to_image: ScaleOption = False
    jobs: int = option("Processes; with --ray actors at most.", default=1, min=1)
    ray: str | None = option("Work on a Ray cluster: its address, or auto.", metavar="ADDRESS")
    every: int = option("Of videos every so many frames.", default=1, min=1)
    batch_rows: int | None = option("Rows that a worker gets at once.", min=1, show_default="32; 8 images")


def batch_command(
    inputs: Annotated[
        list[Path],
        typer.Argument(
            metavar="INPUT...",
            help="Keypoints (json, jsonl, parquet, txt, mat), images, videos, folders, or data sets.",
        ),
    ],
    out: Annotated[Path, typer.Option(metavar="FOLDER", help="For the parts (Parquet); made where it does not exist.")],
    camera: CameraOptions,
    scene: SceneOptions,
    sensors: SensorOptions,
    options: BatchOptions,
    terminal: Terminal,
) -> None:
    """Reconstruct many vehicles: a row for each, in a folder of Parquet files that grows while the work goes on.

    A run that was ended or killed goes on where it was when it is started again with the same folder. With other
    settings it begins anew where nothing at all was reconstructed, and else asks for another folder. Whatever is wrong
    with a vehicle is in its row (status, error), and the others go on. Cars in images and videos are found by the
    shipped networks. --verbose lists how often which error came.

    Exit code 0: at least one vehicle of the inputs was reconstructed, now or before; 1: none; 2: bad usage, or none
    since every row is bad input.
    """
    from fgrecon.batch.batch_request import BatchRequest, reconstruct_files
    from fgrecon.core.options import Options
    from fgrecon.io.arrow import without_pandas
    from fgrecon.perception.boxes import GivenBoxes

    without_pandas()
    screen = terminal.screen()
    how = Options(strategy=scene.strategy, box=options.box_model, keep_history=False)
    settings = scene.settings(how, options.classes)
    apart = ("box_model", "scale_to_image", "boxes", "min_score", "classes")
    rest = {name: value for name, value in vars(options).items() if name not in apart}
    source = camera.source(scale_to_image=options.scale_to_image)
    boxes = GivenBoxes(file=options.boxes, least_score=options.min_score)
    request = BatchRequest(inputs, out, settings, source, sensors=sensors.source(source), boxes=boxes, **rest)
    with screen.bar() as advance:
        tally = reconstruct_files(request, lambda tally: advance("Rows", tally.done, tally.total))
    if code := _report(tally, out, screen, options.table):
        raise typer.Exit(code)


def _report(tally: Tally, out: Path, screen: Screen, table_file: Path | None) -> int:
    """Say what was done; the exit code."""
    from fgrecon.core.reconstruction import Status
    from fgrecon.core.text import counted
    from fgrecon.solve.box_check import boxes_off, boxes_warning

    if tally.anew:
        screen.note(f"{out} had a run with other settings that had reconstructed nothing: it was begun anew.")
    table = compact_table("status", "rows")
    for status, count in sorted(tally.statuses.items()):
        table.add_row(status, str(count))
    verb = "is" if tally.total == 1 else "are"
    screen.print(table, f"{tally.done} of {counted(tally.total, 'row')} {verb} done, {tally.before} of them before.")
    if (off := boxes_off(tally.box_excesses)) is not None:
        screen.warn(boxes_warning(off))
    for line in tally.input_warnings.lines():
        screen.warn(line)
    if tally.left_out:
        of = counted(len(tally.left_out), "row")
        screen.note(f"Of {of} something was left out, as column left_out says; the first is {tally.left_out[0]}")
    screen.wrote(out, *([] if table_file is None else [table_file]))
    solved = {status.value for status in Status if status is not Status.FAILED}
    if not tally.statuses or solved & set(tally.statuses):
        screen.detail(*(f"{count} x {error}" for error, count in tally.errors.most_common()))
        return 0
    screen.fail("No vehicle could be reconstructed.")
    for error, count in tally.errors.most_common(None if screen.verbose else _LISTED):
        screen.fail(f"{count} x {tally.words[error]}")
    return 2 if set(tally.statuses) - {"left_out"} == {"refused"} else 1
