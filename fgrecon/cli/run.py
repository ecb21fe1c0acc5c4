"""`fgrecon run`: a video in, tracked cars out."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fgrecon.cli.commands import option
from fgrecon.cli.options import (
    CameraOptions,
    ClassesOption,
    Delivery,
    JsonOption,
    ScaleOption,
    SceneOptions,
    TogetherOption,
    WeightsOption,
)
from fgrecon.cli.outputs import check_outputs
from fgrecon.cli.sensor_options import SensorOptions
from fgrecon.cli.terminal import Terminal
from fgrecon.core.choices import BoxModel
from fgrecon.core.errors import InvalidInputError

if TYPE_CHECKING:  # the command line must start fast: what the command needs is imported when it runs
    from fgrecon.video.video_job import VideoRequest

_STOPPED = 130


@dataclass(frozen=True)
class FrameOptions:
    """Which frames are taken, and when they were."""

    fps: float | None = option("Frames per second of images without times.", show_default="10; a video's own")
    every: int = option("Take every so many frames.", default=1, min=1)
    start: float = option("Begin so many seconds after the first frame.", default=0.0, min=0.0)
    end: float | None = option("End so many seconds after the first frame.", show_default="the last frame")


@dataclass(frozen=True)
class MotionOptions:
    """How the camera moves."""

    poses: Path | None = option(
        "Poses of the camera: KITTI, TUM, or JSON with matrices; of a bag odometry, or a frame of TF.",
        metavar="FILE|TOPIC",
        show_default="those of a data set or bag",
    )
    estimate_motion: bool | None = option(
        "Estimate the camera's motion from the images; needs the ground.",
        "--estimate-motion/--no-estimate-motion",
        show_default="where the ground is given, and not with --alone",
    )


@dataclass(frozen=True)
class VehicleOptions:
    """Where the vehicles are from, and how they are followed."""

    tracks: Path | None = option(
        "Vehicles detected by others: KITTI's tracking lines, MOT's, keypoints, CSV; a folder: a file for "
        "each image (YOLO, KITTI).",
        metavar="FILE|FOLDER",
    )
    classes: ClassesOption = None
    forget_ids: bool = option("Give those vehicles ids anew.", "--forget-ids", default=False)
    scale_to_image: ScaleOption = False
    box_model: BoxModel | None = option(
        "What 2D boxes enclose; off: they are no evidence.",
        show_default="detected; of --tracks: cuboid in KITTI's lines, surface otherwise",
    )
    weights: WeightsOption = None
    device: str = option(
        "Where the networks run: cpu, or cuda, cuda:1 where there is a GPU.", default="cpu", metavar="NAME"
    )
    online: bool = option(
        "Leave each estimate as it was when its frame came; else it is smoothed.", "--online", default=False
    )
    alone: bool = option("Take every image on its own: no motion, no smoothing.", "--alone", default=False)
    max_delay: float | None = option(
        "Let frames come as from a camera, by their times, and leave out those whose estimates would be there "
        "later than this; with --online or --alone.",
        metavar="SECONDS",
        show_default="every frame is taken",
    )
    together: TogetherOption = True


@dataclass(frozen=True)
class DrawnOptions:
    """What is drawn of the frames."""

    video: Path | None = option("Write the video with the results drawn into it (H.264).", metavar="FILE.mp4")
    picture: Path | None = option("Draw a frame and its scene from above (png, svg, pdf, jpg).", metavar="FILE")
    picture_frame: int | None = option("Which frame.", metavar="N", show_default="the one with the most cars")


@dataclass(frozen=True)
class RunOptions:
    """How the video is read, followed and drawn."""

    frames: FrameOptions
    motion: MotionOptions
    camera: CameraOptions
    scene: SceneOptions
    delivery: Delivery
    vehicles: VehicleOptions
    sensors: SensorOptions
    drawn: DrawnOptions

    def request(self, source: str, out: Path) -> VideoRequest:
        """What is requested of a video."""
        from fgrecon.core.options import Options
        from fgrecon.video.video_job import VideoRequest

        if self.drawn.picture is None and self.drawn.picture_frame is not None:
            fix = "Say with --picture where it is to be written."
            raise InvalidInputError("picture_frame", "without --picture", fix)
        return VideoRequest(
            source=source,
            out=out,
            settings=self.scene.settings(
                Options(strategy=self.scene.strategy, keep_history=False), self.vehicles.classes
            ),
            camera=self.camera.source(scale_to_image=self.vehicles.scale_to_image),
            **vars(self.frames),
            **vars(self.motion),
            **{n: value for n, value in vars(self.vehicles).items() if n not in ("scale_to_image", "classes")},
            sensors=self.sensors.of_video(source, self.camera.source()),
            video=self.drawn.video,
            picture_frame=self.drawn.picture_frame,
        )


def run_command(
    source: Annotated[
        str,
        typer.Argument(
            metavar="VIDEO|FOLDER|PATTERN|DATASET|BAG|KEYPOINTS",
            help="A video; images: their folder, or a pattern; FOLDER#SEQUENCE/CAMERA of a data set; BAG#TOPIC of ROS "
            "2 (.mcap, .db3); or keypoints alone (json).",
        ),
    ],
    out: Annotated[Path, typer.Option(metavar="FOLDER", help="For the results; made where it does not exist.")],
    options: RunOptions,
    terminal: Terminal,
    json_out: JsonOption = None,
) -> None:
    """Find the cars of a video, follow them, and reconstruct pose, size and motion of each in each frame.

    The folder gets tracks.txt (KITTI's tracking results), tracks.csv, tracks.parquet and frames.jsonl. A run that was
    stopped or killed goes on where it was when it is started again with the same folder; with other priors, grounds or
    options, or for another --picture, the networks need not look again. Ctrl-C writes what there is. A frame that
    cannot be read is a gap. --verbose lists every car and gap.

    Exit code 0: at least one car was reconstructed; 1: none, or --picture is of a frame without any; 2: bad usage or
    input; 130: stopped before the end.
    """
    from fgrecon.cli import run_report
    from fgrecon.io.arrow import without_pandas
    from fgrecon.io.files import check_folder
    from fgrecon.video.video_job import prepare_video, write_tracks

    without_pandas()
    options.delivery.check()
    check_outputs(json_out, options.drawn.video, picture=options.drawn.picture)
    check_folder(out)
    screen = terminal.screen(json_out)
    job = prepare_video(options.request(source, out), screen.warn)
    run, filmed = run_report.perform(job, options.delivery, screen)
    write_tracks(job, run)
    screen.wrote(out)
    drawn = run_report.draw(job, run, options.drawn.picture, screen, filmed=filmed)
    if options.delivery.save is not None:
        with screen.bar() as advance:
            screen.wrote(run_report.recording(job, run, advance).write(options.delivery.save))
    screen.print(run_report.table(run), run.summary)
    screen.detail(*run_report.details(run))
    screen.write_json(run_report.document(job, run))
    if run.stopped:
        screen.fail("Stopped before the end. Start it again to go on.")
        raise typer.Exit(_STOPPED)
    if not run.estimates:
        screen.fail("No car could be reconstructed.")
    if not (run.estimates and drawn):
        raise typer.Exit(1)
