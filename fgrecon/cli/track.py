"""`fgrecon track`: one vehicle in several images, a pose for each and one shape for all."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from fgrecon.cli.commands import option
from fgrecon.cli.options import (
    BOX_MODEL_HELP,
    CameraOptions,
    Delivery,
    HistoryOption,
    JsonOption,
    NamesOption,
    ScaleOption,
    SceneOptions,
)
from fgrecon.cli.outputs import check_outputs
from fgrecon.cli.terminal import Terminal
from fgrecon.core.choices import BoxModel


@dataclass(frozen=True)
class TrackOptions:
    """How tracks are solved, and where the results go."""

    camera: CameraOptions
    scene: SceneOptions
    delivery: Delivery
    box_model: BoxModel = option(BOX_MODEL_HELP, default=BoxModel.SURFACE)
    images: Path | None = option("Folder with the photographs, named by number: 000012.png or .jpg.", metavar="FOLDER")
    picture: Path | None = option("Draw a sheet of all images.", metavar="FILE")
    names: NamesOption = None
    scale_to_image: ScaleOption = False
    json_out: JsonOption = None
    history: HistoryOption = False


def track_command(
    files: Annotated[
        list[Path], typer.Argument(metavar="FILE", help="Tracks, or keypoint files whose instances are one vehicle.")
    ],
    options: TrackOptions,
    terminal: Terminal,
) -> None:
    """Reconstruct one vehicle in several images: a pose for each, and one shape for all of them.

    Where a file has labels, the errors are shown, beside those of each image alone. --verbose lists refused images,
    energies and times.

    Exit code 0: every track was solved; 1: one failed; 2: bad usage or input.
    """
    from fgrecon.cli import track_report
    from fgrecon.core.options import Options
    from fgrecon.core.reconstruction import Status

    options.delivery.check()
    check_outputs(options.json_out, picture=options.picture)
    screen = terminal.screen(options.json_out)
    scene, delivery = options.scene, options.delivery
    keep = options.history or delivery.requested
    settings = scene.settings(Options(strategy=scene.strategy, box=options.box_model, keep_history=keep))
    images, names = options.images, options.names
    source = options.camera.source(scale_to_image=options.scale_to_image)
    solved = [track_report.solve(file, source, settings, images, names) for file in screen.watch(files, "Tracks")]
    solved = track_report.distinguished(solved)

    screen.print(track_report.table(solved))
    for track in solved:
        screen.print(f"{track.name}: {track.result.status.value}: {track.result.message}")
        screen.detail(*track_report.details(track))
        for line in (*track.left_out, *track.contradictions):
            screen.warn(f"{track.name}: {line}")
    screen.write_json(track_report.document(solved, settings, history=options.history))
    if options.picture is not None:
        track_report.draw(options.picture, solved)
        screen.wrote(options.picture)
    if delivery.requested:
        recordings = [(track.name, track.recording) for track in solved]
        delivery.deliver(recordings, screen, several=len(files) > 1)
    failed = [track.name for track in solved if track.result.status is Status.FAILED]
    if failed:
        screen.fail(f"{', '.join(failed)}: solving failed.")
        raise typer.Exit(1)
