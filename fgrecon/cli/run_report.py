"""Output of `fgrecon run`: viewers, video, picture, table, JSON. Imported when it runs."""

from __future__ import annotations

import json
import signal
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib import metadata
from pathlib import Path
from typing import Any

from rich.table import Table

from fgrecon.cli.options import Viewer
from fgrecon.cli.terminal import Advance, Screen, compact_table
from fgrecon.core.text import counted, most_frequent
from fgrecon.io.files import write_text
from fgrecon.io.run_settings import camera_to_dict, content_hash, settings_to_dict
from fgrecon.io.source_frames import SourceFrame
from fgrecon.video import VideoRun
from fgrecon.video.follow import TrackedFrame
from fgrecon.video.video_job import VideoJob, track_video
from fgrecon.viz import Recording
from fgrecon.viz.film import LiveFilm, Showing, film, recorded, still
from fgrecon.viz.sinks import start_viewer

FORMAT = "fgrecon.run/1"

_SHOWN_REASONS = 3  # of a status, in the table

_FILM = "film.json"
"""In the folder of the results: what the film that was written last shows."""


def perform(job: VideoJob, viewer: Viewer, screen: Screen) -> tuple[VideoRun, bool]:
    """Look at the frames, follow the vehicles, smooth; a viewer sees each frame as it comes.

    Returns:
        The run, and whether its film was drawn meanwhile, as it is where estimates stay as they come.
    """
    with (
        screen.bar() as advance,
        _on_interrupt() as stopped,
        _live(job, viewer) as show,
        _filming(job) as film_it,
    ):

        def go_on(run: VideoRun, frame: SourceFrame | None) -> bool:
            show(run.frames[-1], frame)
            if film_it is not None:
                image = None if frame is None else frame.image
                film_it.add(run.frames[-1], image, read=frame is not None)
            gaps = f", {len(run.gaps)} gaps" if run.gaps else ""
            advance("Frames", len(run.frames), run.total, f"{counted(len(run.frames[-1].boxes), 'car')} now{gaps}")
            return not stopped

        def smoothing(run: VideoRun) -> None:
            advance("Smoothing", 0, None, counted(len(run.tracks), "car"))

        viewed = viewer.requested
        run = track_video(job, screen.warn, go_on=go_on, smoothing=smoothing, window_graph=viewed, estimated=viewed)
        if film_it is not None:
            film_it.end(whole=not run.stopped)
        return run, film_it is not None and film_it.finished


@contextmanager
def _filming(job: VideoJob) -> Iterator[LiveFilm | None]:
    """The film that is drawn while frames come; None where none is requested, or estimates change later."""
    request = job.request
    if request.video is None or not (request.online or request.alone):
        yield None
        return
    film_it = LiveFilm(request.video, job.camera)
    try:
        yield film_it
    finally:
        film_it.end(whole=False)


@contextmanager
def _live(job: VideoJob, viewer: Viewer) -> Iterator[Callable[[TrackedFrame, SourceFrame | None], None]]:
    """Sends frames to the viewers that are requested."""
    addresses = [address for address in (viewer.connect, start_viewer() if viewer.spawn else None) if address]
    if addresses:
        from fgrecon.viz.video_recording import LiveRecording  # on use: it imports rerun
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


def recording(job: VideoJob, run: VideoRun, advance: Advance) -> Recording:
    """The recording of a run, frames read once more."""
    from fgrecon.viz.video_recording import video_recording_of  # on use: it imports rerun

    return video_recording_of(lambda: recorded(job.source, run.frames, advance), job.camera)


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


def draw(job: VideoJob, run: VideoRun, picture: Path | None, screen: Screen, *, filmed: bool) -> bool:
    """Draw the video, if the run was not stopped, and a picture, where they are requested.

    Args:
        filmed: Whether the video is drawn already.

    Returns:
        Whether there was something to draw, where a picture is requested.
    """
    request = job.request
    if request.video is not None and not run.stopped:
        if not filmed and _film_stamp(job, request.video) == _text(request.out / _FILM):
            screen.print(f"{request.video} shows this already.")
        else:
            if not filmed:
                with screen.bar() as advance:
                    film(request.video, job.source, run.frames, job.camera, advance)
            screen.wrote(request.video)
            write_text(request.out / _FILM, _film_stamp(job, request.video))
    if picture is None:
        return True
    number, known = request.picture_frame, [head.number for head in run.frames.heads]
    drawn = still(picture, job.source, run.frames, job.camera, job.settings.ground, number)
    if drawn:
        screen.wrote(picture)
    else:
        where = "any frame" if number is None else f"frame {number}"
        if number is not None and number not in known:
            where += f", which is not there: the frames are {min(known)} to {max(known)}"
        screen.fail(f"{picture} is not written: there is no vehicle in {where}.")
    return drawn


def _film_stamp(job: VideoJob, film: Path) -> str:
    """What a film shows, and the film as it is: a finished one is not drawn again."""
    content = {
        "fgrecon": metadata.version("fgrecon"),
        "frames": content_hash(job.request.out / "frames.jsonl"),
        "camera": camera_to_dict(job.camera),
        "records": job.records_depend_on,
        "film": [str(film.resolve()), content_hash(film)],
    }
    return json.dumps(content, indent=1) + "\n"


def _text(path: Path) -> str | None:
    return path.read_text(encoding="utf-8") if path.is_file() else None


def table(run: VideoRun) -> Table:
    """How the estimates ended, and the most frequent reasons."""
    result = compact_table("status", "boxes", "why", text=("status", "why"))
    for status, ended in _endings(run).items():
        why = [f"{count} {reason}" for reason, count in ended["reasons"].items()]
        result.add_row(status, str(ended["boxes"]), "\n".join(why[:_SHOWN_REASONS]))
    return result


def _endings(run: VideoRun) -> dict[str, dict[str, Any]]:
    """How many boxes ended in each status, and for which reasons how many, without their numbers."""
    heads = run.frames.heads
    found = Counter(status.value for head in heads for status in head.found.values())
    refused = sum(len(head.identities) for head in heads) - run.estimates
    return {
        status: {"boxes": count, "reasons": dict(most_frequent(_reasons(run, status)))}
        for status, count in [*sorted(found.items()), *([("refused", refused)] if refused else [])]
    }


def _reasons(run: VideoRun, status: str) -> Iterator[str]:
    for head in run.frames.heads:
        for identity, reasons in head.reasons.items():
            if head.found[identity].value == status:
                yield from reasons


def details(run: VideoRun) -> list[str]:
    """Lines about each car and each gap."""
    lines = [f"car {identity}: {count} frames" for identity, count in sorted(run.tracks.items())]
    return lines + [f"gap {name}: {problem}" for name, problem in run.gaps.items()]


def document(job: VideoJob, run: VideoRun) -> str:
    """The JSON text about a run; the results are in its folder."""
    frames: dict[int, list[int]] = {}
    for head in run.frames.heads:
        for identity in head.identities:
            frames.setdefault(identity, []).append(head.number)
    camera = {"camera": camera_to_dict(job.camera), "estimate_motion": job.moving}
    content = {
        "format": FORMAT,
        "fgrecon": metadata.version("fgrecon"),
        "settings": settings_to_dict(job.settings) | job.records_depend_on | camera,
        "out": str(job.request.out),
        "frames": len(run.frames),
        "frames_before": run.before,
        "stopped": run.stopped,
        "smoothed": run.smoothed,
        "together": job.request.together and not job.request.alone,
        "estimates": run.estimates,
        "statuses": _endings(run),
        "gaps": run.gaps,
        "left_out": run.left_out,
        "delay_seconds": dict(zip(("median", "p95", "most"), run.delay_quantiles or [None] * 3, strict=True)),
        "tracks": [
            {"id": identity, "frames": len(numbers), "first": numbers[0], "last": numbers[-1]}
            for identity, numbers in sorted(frames.items())
        ],
    }
    return json.dumps(content, ensure_ascii=False, allow_nan=False, indent=1) + "\n"
