"""`fgrecon track`: one vehicle in several images, a pose for each and one shape for all."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from fgrecon.cli.common import check_outputs
from fgrecon.cli.deliver import Delivery
from fgrecon.cli.options import BOX_MODEL_HELP, CameraOptions, HistoryOption, JsonOption, NamesOption, SceneOptions
from fgrecon.cli.terminal import Terminal
from fgrecon.core.choices import BoxModel

__all__ = ["track_command"]


def track_command(
    files: Annotated[
        list[Path], typer.Argument(metavar="FILE", help="Tracks, or keypoint files whose instances are one vehicle.")
    ],
    camera: CameraOptions,
    scene: SceneOptions,
    delivery: Delivery,
    terminal: Terminal,
    box_model: Annotated[BoxModel, typer.Option(help=BOX_MODEL_HELP)] = BoxModel.SURFACE,
    images: Annotated[
        Path | None,
        typer.Option(metavar="FOLDER", help="Folder with the photographs, named by number: 000012.png or .jpg."),
    ] = None,
    picture: Annotated[Path | None, typer.Option(metavar="FILE", help="Draw a sheet of all images.")] = None,
    names: NamesOption = None,
    json_out: JsonOption = None,
    history: HistoryOption = False,
) -> None:
    """Reconstruct one vehicle in several images: a pose for each, and one shape for all of them.

    Where a file has labels, the errors are told, beside those of the images one by one. --verbose tells refused images,
    energies and times.

    Exit code 0: every track was solved; 1: one failed; 2: bad usage or input.
    """
    from fgrecon.cli import track_report
    from fgrecon.cli.doubts import about_keypoints
    from fgrecon.core.options import Options
    from fgrecon.core.reconstruction import Status

    delivery.check()
    check_outputs(json_out, picture=picture)
    screen = terminal.screen(json_out)
    settings = scene.settings(Options(strategy=scene.strategy, box=box_model, keep_history=history or delivery.wanted))
    source = camera.source()
    solved = [track_report.solve(file, source, settings, images, names) for file in screen.watch(files, "Tracks")]
    solved = track_report.told_apart(solved)

    screen.print(track_report.table(solved))
    for track in solved:
        screen.print(f"{track.name}: {track.result.status.value}: {track.result.message}")
        screen.detail(*track_report.details(track))
        for line in about_keypoints(track.tasks):
            screen.warn(f"{track.name}: {line}")
    screen.write_json(track_report.document(solved, settings, history=history))
    if picture is not None:
        track_report.draw(picture, solved)
        screen.wrote(picture)
    if delivery.wanted:
        recordings = [(track.name, track.recording) for track in solved]
        delivery.deliver(recordings, screen, several=len(files) > 1)
    failed = [track.name for track in solved if track.result.status is Status.FAILED]
    if failed:
        screen.fail(f"{', '.join(failed)}: solving failed.")
        raise typer.Exit(1)
