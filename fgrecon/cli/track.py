"""`fgrecon track`: one vehicle in several images, a pose for each and one shape for all."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from fgrecon.cli.common import (
    CameraHeightOption,
    GroundOption,
    JsonOption,
    PriorOption,
    check_output,
    console,
    ground_plane,
)
from fgrecon.cli.deliver import ConnectOption, SaveOption, SpawnOption, check_delivery, deliver
from fgrecon.options import BoxModel
from fgrecon.robust import StrategyName

__all__ = ["track_command"]


def track_command(
    files: Annotated[list[Path], typer.Argument(help="Tracks, or keypoint files whose instances are one vehicle.")],
    calib: Annotated[Path | None, typer.Option(help="KITTI calibration file; its P2 is the camera.")] = None,
    intrinsics: Annotated[
        str | None, typer.Option(metavar="FX,FY,CX,CY", help="Camera in pixels.", show_default="from the file")
    ] = None,
    prior: PriorOption = "car14",
    camera_height: CameraHeightOption = None,
    ground: GroundOption = None,
    size_prior: Annotated[
        str | None,
        typer.Option(
            metavar="FLEET",
            help="How large vehicles are: kitti, apollo79, or length,width,height[,their spreads] in m.",
            show_default="as in the shape prior",
        ),
    ] = None,
    strategy: Annotated[StrategyName, typer.Option(help="Robust strategy.")] = StrategyName.MIXTURE,
    box_model: Annotated[
        BoxModel, typer.Option(help="What 2D boxes enclose: the outline or the 3D box; off: they are no evidence.")
    ] = BoxModel.SURFACE,
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
    from fgrecon.catalogue import load_prior
    from fgrecon.cli import batch, track_report
    from fgrecon.files import write_text
    from fgrecon.options import Options
    from fgrecon.priors.size_prior import size_prior as parse_size
    from fgrecon.reconstruction import Status
    from fgrecon.robust import strategy as tuned

    check_delivery(save, connect)
    for path in (picture, None if json_out in (None, "-") else Path(str(json_out))):
        check_output(path)
    plane = ground_plane(ground, camera_height)
    settings = batch.Settings(
        prior=load_prior(prior),
        ground=None if plane is None else plane[0],
        size_prior=None if size_prior is None else parse_size(size_prior),
        options=Options(strategy=tuned(strategy), box_model=box_model),
    )
    source = batch.CameraSource(calib, intrinsics, None, None)
    solved = [track_report.solve(file, source, settings, images) for file in files]

    out = console(error=json_out == "-")
    out.print(track_report.table(solved))
    for track in solved:
        out.print(f"{track.name}: {track.result.status.value}: {track.result.message}", markup=False)
    if json_out is not None:
        text = track_report.document(solved, settings)
        if json_out == "-":
            sys.stdout.write(text)
        else:
            write_text(json_out, text)
    if picture is not None:
        track_report.draw(picture, solved)
    if save is not None or connect is not None or spawn:
        recordings = [(track.name, track.recording) for track in solved]
        deliver(recordings, save, connect, spawn=spawn, several=len(files) > 1)
    if any(track.result.status is Status.FAILED for track in solved):
        raise typer.Exit(1)
