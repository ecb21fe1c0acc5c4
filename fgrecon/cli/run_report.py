"""The work of `fgrecon run`: what is asked for, the run, and its files. Imported when it runs."""

from __future__ import annotations

import json
import signal
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.box import SIMPLE_HEAD
from rich.table import Table

from fgrecon.cli.common import about_camera
from fgrecon.cli.deliver import Viewer
from fgrecon.cli.options import SceneOptions
from fgrecon.cli.run_film import Showing, film, recorded, still
from fgrecon.cli.run_options import FrameOptions, MotionOptions
from fgrecon.cli.settings import CameraSource, Settings, plain_camera, plain_settings
from fgrecon.cli.terminal import Screen
from fgrecon.core.camera import DEFAULT_FIELD_OF_VIEW, Camera, Ground
from fgrecon.core.choices import BoxModel
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.options import Options
from fgrecon.io.export.files import export_rows
from fgrecon.io.files import check_ending, write_text
from fgrecon.io.frames import DEFAULT_RATE, FrameSource, ImageFrames, SourceFrame, numbered_frames, open_frames
from fgrecon.io.images import read_photograph
from fgrecon.io.kitti_calibration import calibration_beside
from fgrecon.io.poses import CameraPoses, read_poses
from fgrecon.io.video import check_video
from fgrecon.perception.keypoints.detect import KeypointCascade
from fgrecon.perception.vehicles.detect import NanodetVehicleDetector
from fgrecon.solve.tracker import Tracker
from fgrecon.video import Follower, FrameLook, GatedAssociation, SingleImages, VideoRun, read_given, run_video
from fgrecon.video.focal import found_camera
from fgrecon.video.follow import TrackedFrame
from fgrecon.video.given import Given
from fgrecon.video.rows import frame_lines, rows_of, tracking_text
from fgrecon.viz import Recording
from fgrecon.viz.picture import FORMATS
from fgrecon.viz.sinks import start_viewer
from fgrecon.viz.video_recording import LiveRecording, video_recording_of

__all__ = [
    "FORMAT",
    "Job",
    "Request",
    "details",
    "document",
    "in_words",
    "perform",
    "prepare",
    "recording",
    "table",
    "write",
]

FORMAT = "fgrecon.run/1"


@dataclass(frozen=True)
class Request:
    """What the command line asks for; the fields are its options."""

    source: str
    out: Path
    frames: FrameOptions
    motion: MotionOptions
    camera: CameraSource
    scene: SceneOptions
    tracks: Path | None
    forget_ids: bool
    box_model: BoxModel | None
    weights: Path | None
    online: bool
    alone: bool
    together: bool
    video: Path | None
    picture: Path | None
    picture_frame: int | None


@dataclass(frozen=True)
class Job:
    """What is to be done, all of it checked.

    Attributes:
        request: What was asked for.
        source: The frames.
        camera: Their camera.
        label_offset: (3,) of KITTI's labels in its frame, or None.
        settings: What holds for every vehicle.
        given: Vehicles found by others, or None.
        poses: Of the camera, or None.
    """

    request: Request
    source: FrameSource
    camera: Camera
    label_offset: NDArray[np.float64] | None
    settings: Settings
    given: Given | None
    poses: CameraPoses | None

    @property
    def records_depend_on(self) -> dict[str, Any]:
        """What the stored records depend on: priors and options may change, and networks need not look again."""
        ask, plane = self.request, self.settings.ground
        moving = ask.motion.estimate_motion
        path = Path(ask.source)
        return {
            "source": str(path.resolve()) if path.exists() else ask.source,
            "bytes": path.stat().st_size if path.is_file() else None,
            "fps": ask.frames.fps,
            "every": ask.frames.every,
            "start": ask.frames.start,
            "end": ask.frames.end,
            "category": self.settings.prior.category.name,
            "weights": None if ask.weights is None else str(ask.weights),
            "tracks": None if ask.tracks is None else [str(ask.tracks.resolve()), ask.tracks.stat().st_size],
            "forget_ids": ask.forget_ids,
            "estimate_motion": moving,
            "camera": plain_camera(self.camera) if moving else None,
            "ground": [*plane.normal.tolist(), plane.distance] if moving and plane is not None else None,
        }


def prepare(ask: Request, screen: Screen) -> Job:
    """Read what is asked for and refuse what cannot be done, before the work.

    Raises:
        InvalidInputError: Something cannot be used; names it.
        MissingPackageError: A package for videos is not installed.
    """
    if ask.video is not None:
        check_video(ask.video)
    if ask.picture is not None:
        check_ending(ask.picture, FORMATS)
    elif ask.picture_frame is not None:
        raise InvalidInputError("picture_frame", "without --picture", "Say with --picture where it is to be written.")
    frames, motion = ask.frames, ask.motion
    settings = ask.scene.settings(Options(strategy=ask.scene.strategy, keep_history=False))
    given = _given(ask, settings)
    times: dict[str, Any] = {"rate": frames.fps, "every": frames.every, "start": frames.start, "end": frames.end}
    if Path(ask.source).suffix.lower() == ".json" and given is not None:
        source: FrameSource = numbered_frames(Path(ask.source), given.vehicles, **times)
        if ask.video is not None or motion.estimate_motion:
            field = "video" if ask.video is not None else "estimate_motion"
            raise InvalidInputError(field, ask.source, "Give images: keypoints alone have none.")
    else:
        source = open_frames(ask.source, **times)
    if source.assumed_rate:
        screen.warn(f"No --fps is given: {DEFAULT_RATE:g} frames per second are assumed; speeds go with it.")
    source_has = BoxModel.DETECTED if given is None else BoxModel.CUBOID if given.cuboids else BoxModel.SURFACE
    model = ask.box_model or source_has
    settings = replace(settings, options=replace(settings.options, box=replace(settings.options.box, model=model)))
    if motion.poses is not None and motion.estimate_motion:
        raise InvalidInputError("poses", str(motion.poses), "Give either --poses or --estimate-motion.")
    if motion.estimate_motion and settings.ground is None:
        fix = "Give --camera-height or --ground: the ground tells how far the camera goes."
        raise InvalidInputError("estimate_motion", "no ground", fix)
    poses = None if motion.poses is None else read_poses(motion.poses)
    camera, offset = _camera(ask, source, given, settings, screen)
    return Job(ask, source, camera, offset, settings, given, poses)


def _given(ask: Request, settings: Settings) -> Given | None:
    """The vehicles that others have found, beside the images or in their place."""
    alone = Path(ask.source) if Path(ask.source).suffix.lower() == ".json" else None
    if alone is not None and ask.tracks is not None:
        raise InvalidInputError("tracks", str(ask.tracks), "Leave it out: keypoints are given already.")
    if (file := ask.tracks or alone) is not None:
        return read_given(file, settings.prior.category, forget_ids=ask.forget_ids)
    if ask.forget_ids:
        raise InvalidInputError("forget_ids", value=True, fix="Give --tracks as well, or leave it out.")
    return None


def _camera(
    ask: Request, source: FrameSource, given: Given | None, settings: Settings, screen: Screen
) -> tuple[Camera, NDArray[np.float64] | None]:
    """The camera, with the size of the first image that can be read, and the offset of KITTI's labels."""
    image = next((frame.image for frame in source.read() if frame.image is not None), None)
    if image is None and (given is None or not given.complete):
        raise InvalidInputError("source", ask.source, "Give frames of which at least one can be read.")
    camera, offset = ask.camera.camera(source.first_file.name)
    if camera is None and given is not None:
        camera = given.camera
    if camera is None and (beside := calibration_beside(source.first_file)) is not None:
        camera, offset = beside.camera, beside.label_offset
    size = None if image is None else (image.shape[1], image.shape[0])
    whole = None if camera is not None or size is None else ask.camera.whole(size)
    if whole is not None and isinstance(source, ImageFrames):
        camera = read_photograph(source.first_file, whole)[1]  # by its EXIF data
    told = camera is not None
    if camera is None and whole is not None:
        camera = Camera.of_unknown(*whole)
    if camera is None:
        raise InvalidInputError("camera", "none", "Give --camera or --intrinsics.")
    camera = ask.camera.complete(camera, declared=False)
    if size is not None:
        camera = replace(camera, image_size=size)
    if not told:
        camera = _found(ask, source, given, settings, camera, screen)
    return replace(camera, focal_sigma=0.0), offset  # one focal length for all frames


def _found(
    ask: Request, source: FrameSource, given: Given | None, settings: Settings, unknown: Camera, screen: Screen
) -> Camera:
    """The camera that the vehicles of some frames tell, or one with a usual field of view."""
    arguments = {"prior": settings.prior, "size_prior": settings.size_prior, "options": settings.options}
    look = _look(ask, settings, given)
    found = found_camera(source, look, unknown, ground=settings.ground, **arguments)
    if found is None:
        screen.warn(
            f"No camera is given, and no car tells: a horizontal field of view of {DEFAULT_FIELD_OF_VIEW:g} degrees is "
            "assumed, and distances are rough. Give --camera or --intrinsics."
        )
        return unknown
    screen.warn(about_camera(found.camera, None, f"{found.vehicles} cars of {found.images} frames"))
    return found.camera


def _look(
    ask: Request, settings: Settings, given: Given | None, moving: tuple[Camera, Ground] | None = None
) -> FrameLook:
    """What looks at the frames."""
    return FrameLook(
        settings.prior.category,
        vehicle_detector=NanodetVehicleDetector() if given is None else None,
        keypoint_detector=None if given is not None and given.complete else KeypointCascade(ask.weights),
        given=None if given is None else given.vehicles,
        moving=moving,
    )


def perform(job: Job, viewer: Viewer, screen: Screen) -> VideoRun:
    """Look at the frames, follow the vehicles, smooth; a viewer sees each frame as it comes."""
    ask, settings, given = job.request, job.settings, job.given
    arguments: dict[str, Any] = {
        "prior": settings.prior,
        "size_prior": settings.size_prior,
        "options": settings.options,
    }
    tracker = SingleImages(**arguments) if ask.alone else Tracker(**arguments, shared_ground=ask.together)
    association = GatedAssociation(first=0 if given is None else given.largest_id + 1)
    moving = ask.motion.estimate_motion
    follower = Follower(tracker, association, job.camera, ground=settings.ground, poses=job.poses, moving=moving)
    seen_from = (job.camera, settings.ground) if moving and settings.ground is not None else None
    look = _look(ask, settings, given, seen_from)
    ask.out.mkdir(parents=True, exist_ok=True)
    with screen.bar() as advance, _on_interrupt() as stopped, _live(job, viewer) as show:

        def report(run: VideoRun, frame: SourceFrame | None) -> None:
            show(run.frames[-1], frame)
            gaps = f", {len(run.gaps)} gaps" if run.gaps else ""
            advance("Frames", len(run.frames), run.total, f"{len(run.frames[-1].boxes)} cars now{gaps}")

        return run_video(
            job.source,
            look,
            follower,
            ask.out,
            settings=job.records_depend_on,
            online=ask.online or ask.alone,
            stop=lambda: bool(stopped),
            report=report,
        )


@contextmanager
def _live(job: Job, viewer: Viewer) -> Iterator[Callable[[TrackedFrame, SourceFrame | None], None]]:
    """Sends frames to the viewers that are wanted."""
    addresses = [address for address in (viewer.connect, start_viewer() if viewer.spawn else None) if address]
    recordings = [LiveRecording(job.request.out.name, address, job.camera) for address in addresses]
    showing = Showing()

    def show(tracked: TrackedFrame, frame: SourceFrame | None) -> None:
        if recordings:
            shown = showing.frame(tracked, None if frame is None else frame.image)
            for recording in recordings:
                recording.add(shown)

    try:
        yield show
    finally:
        for recording in recordings:
            recording.end()


def recording(job: Job, run: VideoRun) -> Recording:
    """The recording of a run, frames read once more."""
    return video_recording_of(lambda: recorded(job.source, run.frames), job.camera)


@contextmanager
def _on_interrupt() -> Iterator[list[int]]:
    """A list that is no longer empty after the first Ctrl-C; the second one is as ever."""
    stopped: list[int] = []

    def stop(number: int, _: Any) -> None:
        stopped.append(number)
        signal.signal(signal.SIGINT, before)

    before = signal.signal(signal.SIGINT, stop)
    try:
        yield stopped
    finally:
        signal.signal(signal.SIGINT, before)


def write(job: Job, run: VideoRun, screen: Screen) -> None:
    """Write tables and frames, each whole; where wanted a picture and, if the run was not stopped, the video."""
    out = job.request.out
    write_text(out / "tracks.txt", tracking_text(run.frames, job.label_offset))
    write_text(out / "frames.jsonl", "".join(frame_lines(run.frames)))
    if rows := rows_of(run.frames):
        export_rows(out / "tracks.csv", rows)
        export_rows(out / "tracks.parquet", rows_of(run.frames, flat=False))
    screen.wrote(out)
    if job.request.video is not None and not run.stopped:
        with screen.bar() as advance:
            screen.wrote(film(job.request.video, job.source, run.frames, job.camera, advance))
    if job.request.picture is not None:
        number, ground = job.request.picture_frame, job.settings.ground
        screen.wrote(still(job.request.picture, job.source, run.frames, job.camera, ground, number))


def table(run: VideoRun) -> Table:
    """How the estimates ended."""
    found = Counter(e.reconstruction.status.value for frame in run.frames for e in frame.estimates.values())
    refused = sum(len(frame.boxes) for frame in run.frames) - run.estimates
    result = Table(box=SIMPLE_HEAD, show_edge=False, pad_edge=False, collapse_padding=True)
    result.add_column("status")
    result.add_column("boxes", justify="right")
    for status, count in [*sorted(found.items()), *([("refused", refused)] if refused else [])]:
        result.add_row(status, str(count))
    return result


def in_words(run: VideoRun) -> str:
    """What the run was."""
    gaps = f", {len(run.gaps)} of them gaps" if run.gaps else ""
    before = f"; {run.before} were looked at before" if run.before else ""
    how = "smoothed" if run.smoothed else "each estimate as of its frame"
    return f"{len(run.frames)} frames{gaps}, {len(run.tracks)} cars, {run.estimates} estimates, {how}{before}."


def details(run: VideoRun) -> list[str]:
    """Lines about each car and each gap."""
    lines = [f"car {identity}: {count} frames" for identity, count in sorted(run.tracks.items())]
    return lines + [f"gap {name}: {problem}" for name, problem in run.gaps.items()]


def document(job: Job, run: VideoRun) -> str:
    """The JSON text about a run; the results are in its folder."""
    seen: dict[int, list[int]] = {}
    for frame in run.frames:
        for identity in frame.boxes:
            seen.setdefault(identity, []).append(frame.number)
    content = {
        "format": FORMAT,
        "fgrecon": metadata.version("fgrecon"),
        "settings": plain_settings(job.settings) | job.records_depend_on | {"camera": plain_camera(job.camera)},
        "out": str(job.request.out),
        "frames": len(run.frames),
        "frames_before": run.before,
        "stopped": run.stopped,
        "smoothed": run.smoothed,
        "together": job.request.together and not job.request.alone,
        "estimates": run.estimates,
        "gaps": run.gaps,
        "tracks": [
            {"id": identity, "frames": len(numbers), "first": numbers[0], "last": numbers[-1]}
            for identity, numbers in sorted(seen.items())
        ],
    }
    return json.dumps(content, ensure_ascii=False, allow_nan=False, indent=1) + "\n"
