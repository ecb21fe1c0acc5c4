"""The work of `fgrecon run`: the run, its files, and what is said of it. Imported when it runs."""

from __future__ import annotations

import json
import signal
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib import metadata
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.table import Table

from fgrecon.cli.deliver import Viewer
from fgrecon.cli.doubts import about_video
from fgrecon.cli.run_film import Showing, film, recorded, still
from fgrecon.cli.run_job import Job
from fgrecon.cli.settings import plain_camera, plain_settings
from fgrecon.cli.terminal import Screen
from fgrecon.core.text import counted
from fgrecon.io.export.formats import export_rows
from fgrecon.io.files import write_text
from fgrecon.io.frames import SourceFrame
from fgrecon.solve.box_check import boxes_warning
from fgrecon.solve.tracker import Tracker
from fgrecon.video import Follower, GatedAssociation, MotionEstimator, SingleImageTracker, VideoRun, run_video
from fgrecon.video.follow import TrackedFrame
from fgrecon.video.rows import frame_lines, rows_of, tracking_text
from fgrecon.viz import Recording
from fgrecon.viz.sinks import start_viewer
from fgrecon.viz.video_recording import LiveRecording, video_recording_of

__all__ = ["FORMAT", "details", "document", "in_words", "perform", "recording", "table", "write"]

FORMAT = "fgrecon.run/1"


def perform(job: Job, viewer: Viewer, screen: Screen) -> VideoRun:
    """Look at the frames, follow the vehicles, smooth; a viewer sees each frame as it comes."""
    ask, settings, given = job.request, job.settings, job.given
    arguments: dict[str, Any] = {
        "prior": settings.prior,
        "size_prior": settings.size_prior,
        "options": settings.options,
    }
    tracker = SingleImageTracker(**arguments) if ask.alone else Tracker(**arguments, shared_ground=ask.together)
    forget = tracker.forget if ask.online and isinstance(tracker, Tracker) else None  # nothing smooths their past
    ids: dict[str, Any] = {} if given is None else {"settings": given.association, "first": given.largest_id + 1}
    association = GatedAssociation(**ids, given_up=forget)
    ground = settings.ground
    window_graph = tracker.window_graph if isinstance(tracker, Tracker) and viewer.wanted else None
    follower = Follower(
        *(tracker, association, job.camera),
        ground=ground,
        poses=job.poses,
        moving=job.moving,
        window_graph=window_graph,
    )
    motion = MotionEstimator(job.camera, ground) if job.moving and ground is not None else None
    with screen.bar() as advance, _on_interrupt() as stopped, _live(job, viewer) as show:

        def go_on(run: VideoRun, frame: SourceFrame | None) -> bool:
            show(run.frames[-1], frame)
            gaps = f", {len(run.gaps)} gaps" if run.gaps else ""
            advance("Frames", len(run.frames), run.total, f"{counted(len(run.frames[-1].boxes), 'car')} now{gaps}")
            return not stopped

        run = run_video(
            job.source,
            job.look,
            follower,
            ask.out,
            settings=job.records_depend_on,
            motion=motion,
            online=ask.online or ask.alone,
            go_on=go_on,
        )
    if isinstance(tracker, Tracker) and (off := tracker.boxes_off()) is not None:
        screen.warn(boxes_warning(off))
    numbers = [frame.number for frame in run.frames]
    if numbers and given is not None and not run.stopped and given.vehicles.keys().isdisjoint(numbers):
        screen.warn(
            f"No vehicle is given in a frame of the video: those are frames {min(numbers)} to {max(numbers)}, and the "
            f"vehicles are in frames {min(given.vehicles)} to {max(given.vehicles)}."
        )
    if given is not None and not given.cuboids:  # keypoints, and no boxes in which the network has found them
        for line in about_video(run.frames, job.camera):
            screen.warn(line)
    return run


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


def write(job: Job, run: VideoRun, screen: Screen) -> bool:
    """Write tables and frames, each whole; where wanted a picture and, if the run was not stopped, the video.

    Returns:
        Whether there was something to draw, where a picture is wanted.
    """
    out = job.request.out
    write_text(out / "tracks.txt", tracking_text(run.frames, job.label_offset))
    write_text(out / "frames.jsonl", "".join(frame_lines(run.frames, job.settings.ground)))
    for name, flat in (("tracks.csv", True), ("tracks.parquet", False)):
        if rows := rows_of(run.frames, flat=flat):
            export_rows(out / name, rows)
        else:  # there are no columns without a row, and a table of the run before would be taken for this one's
            (out / name).unlink(missing_ok=True)
    screen.wrote(out)
    if job.request.video is not None and not run.stopped:
        with screen.bar() as advance:
            screen.wrote(film(job.request.video, job.source, run.frames, job.camera, advance))
    picture, number = job.request.picture, job.request.picture_frame
    if picture is None:
        return True
    drawn = still(picture, job.source, run.frames, job.camera, job.settings.ground, number)
    if drawn:
        screen.wrote(picture)
    else:
        where = "any frame" if number is None else f"frame {number}"
        screen.fail(f"{picture} is not written: there is no vehicle in {where}.")
    return drawn


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
    before = f"; {run.before} {'was' if run.before == 1 else 'were'} looked at before" if run.before else ""
    how = "smoothed" if run.smoothed else "each estimate as of its frame"
    went = "" if run.way is None else f"; the camera went {run.way:.1f} m"
    parts = (counted(len(run.frames), "frame") + gaps, counted(len(run.tracks), "car"))
    return f"{', '.join(parts)}, {counted(run.estimates, 'estimate')}, {how}{went}{before}."


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
    camera = {"camera": plain_camera(job.camera), "estimate_motion": job.moving}
    content = {
        "format": FORMAT,
        "fgrecon": metadata.version("fgrecon"),
        "settings": plain_settings(job.settings) | job.records_depend_on | camera,
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
