"""`fgrecon track`: one vehicle in several images, a pose for each and one shape for all."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from fgrecon.cli.common import (
    BOX_MODEL_HELP,
    CalibOption,
    CameraHeightOption,
    GroundOption,
    IntrinsicsOption,
    JsonOption,
    PriorOption,
    SizePriorOption,
    StrategyOption,
    check_outputs,
    console,
    write_json,
)
from fgrecon.cli.deliver import ConnectOption, SaveOption, SpawnOption, check_delivery, deliver, wants_recording
from fgrecon.core.options import BoxModel
from fgrecon.core.robust import StrategyName

__all__ = ["track_command"]


def track_command(
    files: Annotated[list[Path], typer.Argument(help="Tracks, or keypoint files whose instances are one vehicle.")],
    calib: CalibOption = None,
    intrinsics: IntrinsicsOption = None,
    prior: PriorOption = "car14",
    camera_height: CameraHeightOption = None,
    ground: GroundOption = None,
    size_prior: SizePriorOption = None,
    strategy: StrategyOption = StrategyName.MIXTURE,
    box_model: Annotated[BoxModel, typer.Option(help=BOX_MODEL_HELP)] = BoxModel.SURFACE,
    images: Annotated[
        Path | None, typer.Option(help="Folder with the photographs, named by number: 000012.png or .jpg.")
    ] = None,
    picture: Annotated[Path | None, typer.Option(metavar="FILE", help="Draw a sheet of all images.")] = None,
    save: SaveOption = None,
    connect: ConnectOption = None,
    spawn: SpawnOption = False,
    json_out: JsonOption = None,
) -> None:
    """Reconstruct one vehicle in several images: a pose for each, and one shape for all of them.

    Where a file has labels, the errors are told, beside those of the images one by one.

    Exit code 0: every track was solved; 1: one failed; 2: bad usage or input.
    """
    from fgrecon.cli import batch, track_report
    from fgrecon.core.options import Options
    from fgrecon.core.reconstruction import Status

    check_delivery(save, connect)
    check_outputs(json_out, picture)
    options = Options(strategy=strategy, box=box_model)
    settings = batch.Settings.of(prior, ground, camera_height, size_prior, options)
    source = batch.CameraSource(calib, intrinsics, None, None)
    solved = [track_report.solve(file, source, settings, images) for file in files]

    out = console(error=json_out == "-")
    out.print(track_report.table(solved))
    for track in solved:
        out.print(f"{track.name}: {track.result.status.value}: {track.result.message}", markup=False)
    if json_out is not None:
        write_json(json_out, track_report.document(solved, settings))
    if picture is not None:
        track_report.draw(picture, solved)
    if wants_recording(save, connect, spawn=spawn):
        recordings = [(track.name, track.recording) for track in solved]
        deliver(recordings, save, connect, spawn=spawn, several=len(files) > 1)
    if any(track.result.status is Status.FAILED for track in solved):
        raise typer.Exit(1)
