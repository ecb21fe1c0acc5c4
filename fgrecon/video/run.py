"""A run over a video: frames are looked at once and stored, followed in order, and smoothed at the end.

    frames ---- look (networks; slow) ---- records, stored ---- follow (fast) ---- frames with estimates ---- smoothed

What is stored is what frames show, so that a run that was killed goes on at the frame where it was: the stored records
are followed again, which takes milliseconds a frame, and gives the numbers of a run that was not killed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from fgrecon.batch.parts import Parts, begin, claimed
from fgrecon.io.frames import FrameSource, SourceFrame
from fgrecon.video.follow import Follower, TrackedFrame
from fgrecon.video.look import FrameLook
from fgrecon.video.records import FORMAT, FrameRecord, from_row, record_schema, to_table

__all__ = ["RECORDS", "VideoRun", "run_video"]

RECORDS = "records"
"""Folder of the stored records within that of the run."""


@dataclass
class VideoRun:
    """How far a run over a video has come.

    Attributes:
        total: Frames of the source, as far as it tells; else None.
        before: Frames that runs before this one had looked at.
        stopped: Whether it was stopped before its end.
        smoothed: Whether the estimates of a frame know what came after it.
        frames: The frames so far.
    """

    total: int | None
    before: int = 0
    stopped: bool = False
    smoothed: bool = False
    frames: list[TrackedFrame] = field(default_factory=list)

    @property
    def gaps(self) -> dict[str, str]:
        """Why frames could not be read, by their names."""
        return {frame.name: frame.problem for frame in self.frames if frame.problem is not None}

    @property
    def tracks(self) -> dict[int, int]:
        """How many frames each vehicle was seen in."""
        counts: dict[int, int] = {}
        for frame in self.frames:
            for identity in frame.boxes:
                counts[identity] = counts.get(identity, 0) + 1
        return counts

    @property
    def estimates(self) -> int:
        """How many estimates there are."""
        return sum(len(frame.estimates) for frame in self.frames)


def run_video(
    source: FrameSource,
    look: FrameLook,
    follower: Follower,
    out: Path,
    *,
    settings: Mapping[str, Any],
    online: bool = False,
    stop: Callable[[], bool] = lambda: False,
    report: Callable[[VideoRun, SourceFrame | None], None] = lambda run, frame: None,  # noqa: ARG005 - says nothing
) -> VideoRun:
    """Look at the frames of a source that are not stored yet, and follow the vehicles through all of them.

    Args:
        source: The frames.
        look: What looks at them.
        follower: What follows the vehicles; a new one.
        out: Folder of the run; records go to a folder in it.
        settings: What the records depend on, as plain values; a folder is for one such.
        online: Whether estimates stay as they were when their frame came, instead of being smoothed.
        stop: Asked before each frame whether to stop.
        report: Called after each frame with the run and the frame's pixels; None for what runs before had looked at.

    Returns:
        The run.

    Raises:
        InvalidInputError: The folder holds another run, or one that is going on.

    Warns:
        DamagedFileWarning: Stored records are damaged; their frames, and those after them, are looked at again.
    """
    folder = out / RECORDS
    begin(folder, settings, FORMAT)
    run = VideoRun(source.count)
    with claimed(folder):
        parts = Parts(folder, record_schema())
        stored = [from_row(row) for row in parts.rows_in_order()]
        run.before = len(stored)
        try:
            for record, frame in _records(source, look, stored, parts):
                run.frames.append(follower(record))
                report(run, frame)
                if stop():
                    run.stopped = run.total is None or len(run.frames) < run.total
                    break
        finally:
            parts.flush()
    if not online:
        run.frames = _smoothed(run.frames, follower)
        run.smoothed = True
    return run


def _records(
    source: FrameSource, look: FrameLook, stored: list[FrameRecord], parts: Parts
) -> Iterator[tuple[FrameRecord, SourceFrame | None]]:
    """The stored records, then those of the frames after them, which are stored as well."""
    yield from ((record, None) for record in stored)
    last = stored[-1].number if stored else None
    before = next((record for record in reversed(stored) if record.problem is None), None)
    after = last
    if before is not None and look.remembers:
        after = before.number - 1
    for frame in source.read(after):
        if before is not None and frame.number == before.number:
            look.remember(frame, before)
        if last is not None and frame.number <= last:
            continue
        record = look(frame)
        parts.add(to_table(record))
        yield record, frame


def _smoothed(frames: list[TrackedFrame], follower: Follower) -> list[TrackedFrame]:
    """The frames with the smoother's estimates in the place of the first ones, as far back as it goes."""
    found = {
        (identity, estimate.time): estimate
        for identity, estimates in follower.tracker.smooth().items()
        for estimate in estimates
    }
    return [
        replace(frame, estimates={i: found.get((i, frame.time), first) for i, first in frame.estimates.items()})
        for frame in frames
    ]
