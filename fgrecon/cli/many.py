"""`fgrecon batch`: vehicles by the thousand, from files into a folder of Parquet."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fgrecon.cli.options import BOX_MODEL_HELP, CameraOptions, NamesOption, SceneOptions, WeightsOption
from fgrecon.cli.terminal import Terminal
from fgrecon.core.choices import BoxModel
from fgrecon.core.errors import InvalidInputError

if TYPE_CHECKING:  # the command line must start fast: what the command needs is imported when it runs
    from fgrecon.batch import Tally

__all__ = ["batch_command"]

_TOLD = 3
"""Errors that are told where nothing could be reconstructed."""


def batch_command(
    inputs: Annotated[
        list[Path],
        typer.Argument(
            metavar="INPUT...", help="Keypoints (json, jsonl, parquet, txt, mat), images, videos, or folders."
        ),
    ],
    out: Annotated[Path, typer.Option(metavar="FOLDER", help="For the parts (Parquet); made where it does not exist.")],
    camera: CameraOptions,
    scene: SceneOptions,
    terminal: Terminal,
    box_model: Annotated[
        BoxModel, typer.Option(help=BOX_MODEL_HELP, show_default="surface; detected where the detector finds them")
    ] = BoxModel.SURFACE,
    names: NamesOption = None,
    weights: WeightsOption = None,
    jobs: Annotated[int, typer.Option(min=1, help="Processes; with --ray actors at most.")] = 1,
    ray: Annotated[
        str | None, typer.Option(metavar="ADDRESS", help="Work on a Ray cluster: its address, or auto.")
    ] = None,
    every: Annotated[int, typer.Option(min=1, help="Of videos every so many frames.")] = 1,
    batch_rows: Annotated[
        int | None, typer.Option(min=1, help="Rows that a worker gets at once.", show_default="32; 8 images")
    ] = None,
) -> None:
    """Reconstruct many vehicles: a row for each, in a folder of Parquet files that grows while the work goes on.

    A run that was ended or killed goes on where it was when it is started again with the same folder. With other
    settings it begins anew where nothing at all was reconstructed, and else asks for another folder. Whatever is wrong
    with a vehicle is in its row (status, error), and the others go on. Cars in images and videos are found by the
    shipped networks. --verbose tells how often which error came.

    Exit code 0: at least one vehicle of the inputs was reconstructed, now or before; 1: none; 2: bad usage, or none
    since every row is bad input.
    """
    from rich.box import SIMPLE_HEAD
    from rich.table import Table

    from fgrecon.batch import Reconstructor, run, sources_of
    from fgrecon.cli.settings import content_hash, plain_camera, plain_settings
    from fgrecon.core.options import Options
    from fgrecon.core.reconstruction import Status
    from fgrecon.core.text import counted
    from fgrecon.io.keypoints.names import parse_names
    from fgrecon.solve.box_check import boxes_off, boxes_warning

    screen = terminal.screen()
    settings = scene.settings(Options(strategy=scene.strategy, box=box_model, keep_history=False))
    source = camera.source()
    seen_by = source.camera()[0]
    if seen_by is None and camera.crop is not None:
        raise InvalidInputError("crop", camera.crop, "Give the whole image's camera too: --camera or --intrinsics.")
    seen_by = None if seen_by is None else source.complete(seen_by, declared=False)
    known = None if names is None else parse_names(names, settings.prior.category)
    reconstructor = Reconstructor(
        prior=settings.prior if settings.prior_file else scene.prior,
        camera=seen_by,
        ground=settings.ground,
        size_prior=settings.size_prior,
        options=settings.options,
        names=known,
        weights=weights,
        threads=1,
    )
    told = plain_settings(settings) | {
        "camera": None if seen_by is None else plain_camera(seen_by),
        "weights": None if weights is None else str(weights),
        **({} if names is None else {"names": names}),
    }
    for name, file in (("prior", settings.prior_file), ("weights", weights), ("names", names)):
        if (content := content_hash(None if file is None else Path(file))) is not None:
            told[f"{name}_sha256"] = content
    with screen.bar() as advance:

        def report(tally: Tally) -> None:
            advance("Rows", tally.done, tally.total)

        tally = run(
            sources_of(inputs, every, settings.prior.category),
            out,
            reconstructor,
            jobs=jobs,
            ray=ray,
            batch_rows=batch_rows,
            settings=told,
            report=report,
        )

    if tally.anew:
        screen.note(f"{out} had a run with other settings that had reconstructed nothing: it was begun anew.")
    table = Table(box=SIMPLE_HEAD, show_edge=False, pad_edge=False, collapse_padding=True)
    table.add_column("status")
    table.add_column("rows", justify="right")
    for status, count in sorted(tally.statuses.items()):
        table.add_row(status, str(count))
    verb = "is" if tally.total == 1 else "are"
    screen.print(table, f"{tally.done} of {counted(tally.total, 'row')} {verb} done, {tally.before} of them before.")
    if (off := boxes_off(tally.box_excesses)) is not None:
        screen.warn(boxes_warning(off))
    for line in tally.doubts.lines():
        screen.warn(line)
    screen.wrote(out)
    solved = {status.value for status in Status if status is not Status.FAILED}
    if not tally.statuses or solved & set(tally.statuses):
        screen.detail(*(f"{count} x {error}" for error, count in tally.errors.most_common()))
        return
    screen.fail("No vehicle could be reconstructed.")
    for error, count in tally.errors.most_common(None if screen.verbose else _TOLD):
        screen.fail(f"{count} x {tally.words[error]}")
    raise typer.Exit(2 if set(tally.statuses) == {"refused"} else 1)
