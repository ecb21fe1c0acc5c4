"""`fgrecon run`: a video in, tracked cars out."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from fgrecon.cli.common import check_outputs
from fgrecon.cli.deliver import Delivery
from fgrecon.cli.options import CameraOptions, JsonOption, SceneOptions, TogetherOption, WeightsOption
from fgrecon.cli.run_options import FrameOptions, MotionOptions
from fgrecon.cli.terminal import Terminal
from fgrecon.core.choices import BoxModel

__all__ = ["run_command"]

_STOPPED = 130


def run_command(
    source: Annotated[
        str,
        typer.Argument(
            metavar="VIDEO|FOLDER|PATTERN|KEYPOINTS",
            help="A video; images: their folder, or a pattern; or keypoints alone (json).",
        ),
    ],
    out: Annotated[Path, typer.Option(metavar="FOLDER", help="For the results; made where it does not exist.")],
    frames: FrameOptions,
    motion: MotionOptions,
    camera: CameraOptions,
    scene: SceneOptions,
    delivery: Delivery,
    terminal: Terminal,
    tracks: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Vehicles found by others: KITTI's tracking labels, or keypoints."),
    ] = None,
    forget_ids: Annotated[bool, typer.Option("--forget-ids", help="Give those vehicles ids anew.")] = False,
    box_model: Annotated[
        BoxModel | None,
        typer.Option(
            help="What 2D boxes enclose; off: they are no evidence.",
            show_default="detected; of --tracks: surface in keypoints, cuboid in KITTI's lines",
        ),
    ] = None,
    weights: WeightsOption = None,
    online: Annotated[
        bool, typer.Option("--online", help="Leave each estimate as it was when its frame came; else it is smoothed.")
    ] = False,
    alone: Annotated[bool, typer.Option("--alone", help="Take every image on its own: no motion, no smoothing.")] = (
        False
    ),
    together: TogetherOption = True,
    video: Annotated[
        Path | None, typer.Option(metavar="FILE.mp4", help="Write the video with what was found drawn into it (H.264).")
    ] = None,
    picture: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Draw a frame and its scene from above (png, svg, pdf, jpg)."),
    ] = None,
    picture_frame: Annotated[
        int | None, typer.Option(metavar="N", help="Which frame.", show_default="the one with the most cars")
    ] = None,
    json_out: JsonOption = None,
) -> None:
    """Find the cars of a video, follow them, and reconstruct pose, size and motion of each in each frame.

    The folder gets tracks.txt (KITTI's tracking results), tracks.csv, tracks.parquet and frames.jsonl. A run that was
    stopped or killed goes on where it was when it is started again with the same folder; with other priors, grounds or
    options, or for another --picture, the networks need not look again. Ctrl-C writes what there is. A frame that
    cannot be read is a gap. --verbose tells every car and gap.

    Exit code 0: at least one car was reconstructed; 1: none, or --picture is of a frame without any; 2: bad usage or
    input; 130: stopped before the end.
    """
    from fgrecon.cli import run_report
    from fgrecon.cli.run_job import Request, prepare

    delivery.check()
    check_outputs(json_out, video, picture=picture)
    screen = terminal.screen(json_out)
    job = prepare(
        Request(
            source=source,
            out=out,
            frames=frames,
            motion=motion,
            camera=camera.source(),
            scene=scene,
            tracks=tracks,
            forget_ids=forget_ids,
            box_model=box_model,
            weights=weights,
            online=online,
            alone=alone,
            together=together,
            video=video,
            picture=picture,
            picture_frame=picture_frame,
        ),
        screen,
    )
    run = run_report.perform(job, delivery, screen)
    drawn = run_report.write(job, run, screen)
    if delivery.save is not None:
        screen.wrote(run_report.recording(job, run).write(delivery.save))
    screen.print(run_report.table(run), run_report.in_words(run))
    screen.detail(*run_report.details(run))
    screen.write_json(run_report.document(job, run))
    if run.stopped:
        screen.fail("Stopped before the end. Start it again to go on.")
        raise typer.Exit(_STOPPED)
    if not run.estimates:
        screen.fail("No car could be reconstructed.")
    if not (run.estimates and drawn):
        raise typer.Exit(1)
