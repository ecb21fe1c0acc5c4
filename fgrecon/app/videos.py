"""What a worker makes of an uploaded video: `fgrecon run` in the visitor's folder, with progress that the page reads.

video ---- frames looked at, cars followed, smoothed ---- film, tables, recording as files; timelines as plain values
"""

from __future__ import annotations

import json
import os
import time
from collections import Counter, defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fgrecon.app.requested import PageRequested
from fgrecon.app.solving import without_folder
from fgrecon.core.errors import FgreconError
from fgrecon.core.metrics import wrap_angle
from fgrecon.core.reconstruction import rotation_y
from fgrecon.core.vehicle_estimate import VehicleEstimate
from fgrecon.io.files import write_text
from fgrecon.io.source_frames import SourceFrame
from fgrecon.video.follow import TrackedFrame
from fgrecon.video.run import VideoRun
from fgrecon.video.video_job import VideoRequest, prepare_video, track_video, write_tracks
from fgrecon.viz.film import film, recorded, values_of

FILM, RECORDING, FRAMES, TABLE_FILE = "film.mp4", "recording.rrd", "frames.jsonl", "tracks.csv"
"""Files that are left in the folder."""

BANDS = ("heading", "speed", "length", "width", "height")
"""What a timeline has of a car, each with its band of 95 %; degrees, km/h and metres."""

_PROGRESS, _STOP, _LEFT = "progress.json", "stop", "left"
_SOONEST = 0.2  # seconds between two lines of progress
_NICE = 10  # photographs come first
_KMH, _TURN = 3.6, 360.0

Band = list[float | None]


@dataclass(frozen=True)
class Progress:
    """How far the work on a video has come."""

    step: str  # what is being done
    done: int  # how much of it
    total: int | None  # how much there is; None where nobody knows
    rate: float  # how much each second

    def __str__(self) -> str:
        """In words."""
        of = "" if self.total is None else f" of {self.total}"
        return f"{self.step}: {self.done}{of}, {self.rate:.1f} per second" if self.done else f"{self.step} ..."


@dataclass(frozen=True)
class CarMoment:
    """A car in a frame."""

    time: float  # seconds after the first frame of the video
    bands: dict[str, Band]  # for each of `BANDS` the value and its band, None where it is not known
    others: list[tuple[float, float]]  # heading in degrees and probability of each other possible pose


@dataclass(frozen=True)
class FollowedCar:
    """A car of a video: its id, in how many frames it is, and where it has a pose."""

    name: str
    frames: int
    moments: list[CarMoment]


@dataclass(frozen=True)
class VideoView:
    """What the page shows of a video."""

    words: str  # what became of it
    warnings: list[str]  # what there is to warn of
    cars: list[FollowedCar]  # those that were followed, the one of the most frames first
    filmed: bool  # whether there is a film


def stop(out: Path, *, left: bool = False) -> None:
    """Let the work on a video end soon, with what there is; or with nothing, where nobody waits for it any more."""
    (out / (_LEFT if left else _STOP)).touch()


def progress_of(out: Path) -> Progress | None:
    """How far the work has come; None before its first frame."""
    try:
        return Progress(**json.loads((out / _PROGRESS).read_text(encoding="utf-8")))
    except FileNotFoundError:
        return None


class _Teller:
    """Leaves word of how far the work has come, and ends it where nobody waits for it."""

    def __init__(self, out: Path) -> None:
        self._out, self._step = out, ""
        self._begun = self._reported = 0.0

    def __call__(self, step: str, done: int, total: int | None) -> None:
        now = time.monotonic()
        if (self._out / _LEFT).exists():
            raise FgreconError("Nobody waits for it.")
        if step != self._step:
            self._step, self._begun = step, now
        elif now - self._reported < _SOONEST:
            return
        self._reported = now
        rate = done / (now - self._begun) if now > self._begun else 0.0
        progress = {"step": step, "done": done, "total": total, "rate": rate}
        write_text(self._out / _PROGRESS, json.dumps(progress))


def track_upload(folder: Path, name: str, out: Path, requested: PageRequested) -> VideoView:
    """Follow the cars of a video.

    Args:
        folder: Where it is.
        out: Where its results are left.
    """
    if hasattr(os, "setpriority"):
        os.setpriority(os.PRIO_PROCESS, 0, _NICE)
    warnings: list[str] = []
    advance = _Teller(out)
    with without_folder(folder):
        settings = requested.settings(history=False)
        request = VideoRequest(
            source=str(folder / name),
            out=out,
            settings=settings,
            camera=requested.source(),
            box_model=requested.given_box_model,
            together=requested.together != "no",
            video=out / FILM,
            **requested.frames(),
        )
        job = prepare_video(request, warnings.append)

        def go_on(run: VideoRun, _: SourceFrame | None) -> bool:
            advance("Frames", len(run.frames), run.total)
            return not (out / _STOP).exists()

        run = track_video(
            job, warnings.append, go_on=go_on, smoothing=lambda _: advance("Smoothing", 0, None), window_graph=True
        )
        write_tracks(job, run)
    filmed = any(head.problem is None for head in run.frames.heads)
    if filmed:
        from fgrecon.viz.video_recording import video_recording_of  # on use: it imports rerun

        film(out / FILM, job.source, run.frames, job.camera, advance)
        made = video_recording_of(lambda: recorded(job.source, run.frames, advance), job.camera)
        made.write(out / RECORDING)
    return VideoView(run.summary, warnings, followed(run.frames), filmed)


def followed(frames: Sequence[TrackedFrame]) -> list[FollowedCar]:
    """The cars of some frames over time, the one of the most frames first."""
    counts: Counter[int] = Counter()
    moments: defaultdict[int, list[CarMoment]] = defaultdict(list)
    begun = frames[0].time if frames else 0.0
    for frame in frames:
        counts.update(frame.boxes.keys())
        for identity, estimate in frame.estimates.items():
            if estimate.reconstruction.status.determined:
                moments[identity].append(_moment(frame.time - begun, estimate))
    return [FollowedCar(str(i), count, _unwrapped(moments[i])) for i, count in counts.most_common()]


def _moment(seconds: float, estimate: VehicleEstimate) -> CarMoment:
    values = {"heading" if name == "yaw" else name: band for name, band in values_of(estimate).items()}
    scale = {"speed": _KMH}
    bands: dict[str, Band] = {name: _band(values.get(name, ()), scale.get(name, 1.0)) for name in BANDS}
    result = estimate.reconstruction
    others = [
        (_degrees(rotation_y(other.camera_T_object)), other.probability)
        for other in result.uncertainty.alternatives
        if np.isfinite(other.probability)
    ]
    if not others and np.isfinite(estimate.facing_probability):
        others = [(_degrees(result.rotation_y + np.pi), 1.0 - estimate.facing_probability)]
    return CarMoment(round(seconds, 3), bands, [(heading, round(float(share), 3)) for heading, share in others])


def _band(numbers: Sequence[float], scale: float) -> Band:
    known = [round(scale * number, 3) if np.isfinite(number) else None for number in numbers]
    return known or [None] * 3


def _degrees(angle: float) -> float:
    return round(float(np.degrees(wrap_angle(angle))), 1)


def _unwrapped(moments: list[CarMoment]) -> list[CarMoment]:
    """Headings without jumps by whole turns, so that a line can be drawn through them."""
    before = 0.0
    for moment in moments:
        heading = moment.bands["heading"]
        if heading[0] is not None:
            turns = _TURN * round((before - heading[0]) / _TURN)
            moment.bands["heading"] = [None if value is None else value + turns for value in heading]
            before = heading[0] + turns
    return moments
