"""A run over a video: frames are detected once and stored, tracked in order, and smoothed as vehicles leave.

    frames ---- look (networks; slow) ---- records, stored ---- follow (fast) ---- frames with estimates ---- smoothed
       |                                                           |
       +------- the camera's motion ---- motions, stored ----------+

Reading, networks, motion and following are stages side by side (`fgrecon.video.stages`); the results are those of one
after the other. What is stored is what frames show, so that a run that was killed goes on at the frame where it was:
the stored records are followed again, which takes milliseconds a frame, and gives the numbers of a run that was not
killed. Motions are stored for one camera and one ground: with another they are estimated again, and the networks need
not look again.
"""

from __future__ import annotations

import warnings
from collections import Counter
from collections.abc import Callable, Collection, Generator, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import closing
from dataclasses import dataclass, field, replace
from itertools import pairwise, zip_longest
from pathlib import Path
from typing import Any

import numpy as np

from fgrecon.batch.parts import RECORDS, Parts, begin, claimed, refuse_batch
from fgrecon.core.errors import InvalidInputError, UncoveredFramesWarning
from fgrecon.core.text import counted, whole_text
from fgrecon.core.vehicle_estimate import VehicleEstimate
from fgrecon.io.frames import FrameSource, ImageFrames
from fgrecon.io.source_frames import SourceFrame
from fgrecon.video.camera_path import MotionEstimator
from fgrecon.video.coverage import check_coverage, coverage_warnings, planned_frames
from fgrecon.video.egomotion import CameraMotion
from fgrecon.video.follow import Follower
from fgrecon.video.frame_detector import FrameDetector
from fgrecon.video.frame_store import FrameStore
from fgrecon.video.newest import LiveFrames, is_left_out
from fgrecon.video.records import (
    FORMAT,
    FrameRecord,
    Sighting,
    from_row,
    motion_from_row,
    motion_schema,
    motion_to_table,
    record_schema,
    to_table,
)
from fgrecon.video.stages import made_ahead, rare_collections, short_turns

__all__ = ["MOTIONS", "RECORDS", "VideoRun", "run_video"]

AHEAD = 2
"""Frames that a stage, in a thread of its own, is ahead of the next one: enough for frames with many and with few
vehicles in turn. With 0 one frame and stage comes after the other; results are the same to the last bit."""

MOTIONS = "motions"
"""Folder of the camera's motions within that of the run, beside the stored records' (`RECORDS`)."""


@dataclass
class VideoRun:
    """How far a run over a video has come.

    Attributes:
        total: About how many frames the source has, for progress; None where it does not tell.
        before: Frames that runs before this one had looked at.
        stopped: Whether it was stopped before its end.
        smoothed: Whether the estimates of a frame know what came after it.
        frames: The frames so far, in a file: each is read when it is looked at.
        warnings: What is given by frame and is not of these frames.
        delays: Seconds from the coming of a frame until its estimates were there; none where they do not come live.
    """

    total: int | None
    before: int = 0
    stopped: bool = False
    smoothed: bool = False
    frames: FrameStore = field(default_factory=FrameStore)
    warnings: list[str] = field(default_factory=list)
    delays: Collection[float] = ()

    @property
    def gaps(self) -> dict[str, str]:
        """Why frames could not be read, by their names."""
        problems = {head.name: head.problem for head in self.frames.heads if head.problem is not None}
        return {name: problem for name, problem in problems.items() if not is_left_out(problem)}

    @property
    def left_out(self) -> int:
        """How many frames were left out because a newer one had come."""
        return sum(is_left_out(head.problem) for head in self.frames.heads)

    @property
    def delay_quantiles(self) -> tuple[float, float, float] | None:
        """Median, 95th percentile and largest of the delays, seconds; None where there are none."""
        if not self.delays:
            return None
        middle, high, most = np.percentile([*self.delays], [50.0, 95.0, 100.0]).tolist()
        return middle, high, most

    @property
    def tracks(self) -> dict[int, int]:
        """How many frames each vehicle was observed in."""
        return dict(Counter(identity for head in self.frames.heads for identity in head.identities))

    @property
    def way(self) -> float | None:
        """How far the camera went, metres; None where nothing tells."""
        places = [head.place for head in self.frames.heads if head.place is not None]
        return float(sum(np.linalg.norm(b - a) for a, b in pairwise(places))) if len(places) > 1 else None

    @property
    def estimates(self) -> int:
        """How many estimates there are."""
        return sum(len(head.found) for head in self.frames.heads)

    @property
    def summary(self) -> str:
        """What it was, in a sentence."""
        gaps = f", {len(self.gaps)} of them gaps" if self.gaps else ""
        gaps += f", {self.left_out} left out for newer ones" if self.left_out else ""
        before = f"; {self.before} {'was' if self.before == 1 else 'were'} looked at before" if self.before else ""
        how = "smoothed" if self.smoothed else "each estimate as of its frame"
        went = "" if self.way is None else f"; the camera went {self.way:.1f} m"
        parts = (counted(len(self.frames), "frame") + gaps, counted(len(self.tracks), "car"))
        late = self.delay_quantiles
        delay = "" if late is None else f"; delay {1e3 * late[0]:.0f} ms, of 95 % up to {1e3 * late[1]:.0f} ms"
        return f"{', '.join(parts)}, {counted(self.estimates, 'estimate')}, {how}{went}{before}{delay}."

    def smooth(self, follower: Follower) -> None:
        """Put the smoother's estimates in the place of the first ones, as far back as it goes."""
        smoothed = dict(follower.tracker.smooth())
        while smoothed:  # and no vehicle's are kept
            self.put(follower, *smoothed.popitem())
        self.smoothed = True

    def put(self, follower: Follower, identity: int, estimates: Sequence[VehicleEstimate]) -> None:
        """Put a vehicle's estimates in the place of the first ones.

        Args:
            follower: What has followed the vehicles.
            identity: Of the vehicle.
            estimates: In the tracker's world.
        """
        for one in estimates:
            self.frames.put(identity, follower.over_world(one))


def run_video(
    source: FrameSource,
    frame_detector: FrameDetector,
    follower: Follower,
    out: Path,
    *,
    settings: Mapping[str, Any],
    motion: MotionEstimator | None = None,
    online: bool | LiveFrames = False,
    go_on: Callable[[VideoRun, SourceFrame | None], bool] = lambda run, frame: True,  # noqa: ARG005 - to the end
) -> VideoRun:
    """Look at the frames of a source that are not stored yet, and follow the vehicles through all of them.

    Args:
        source: The frames.
        frame_detector: What looks at them.
        follower: What follows the vehicles; a new one.
        out: Folder of the run; records go to a folder in it.
        settings: What the records depend on, as plain values; a folder is for one such.
        motion: Estimates the camera's motion, a new one; None where it is not estimated.
        online: Whether estimates stay as they were when their frame came, until `VideoRun.smooth`. `LiveFrames`: so it
            is, and frames come live, one frame and stage after the other.
        go_on: Called after each frame with the run and the frame's pixels, None for what runs before had looked at;
            returns whether to go on.

    Raises:
        InvalidInputError: The folder holds a batch, another run or one that is going on, or images that it has looked
            at are no more, or others have come before them; or no frame has a pose or a vehicle of those given.

    Warns:
        UncoveredFramesWarning: Frames have no pose of those given, or vehicles are given for frames that are not there.
        DamagedFileWarning: Stored records are damaged; their frames, and those after them, are looked at again.
    """
    refuse_batch(out)
    given = (follower.path.poses, None if frame_detector.given is None else frame_detector.given.keys())
    if any(given):
        check_coverage(planned_frames(source) or (), *given)
    begin(out / RECORDS, settings, FORMAT)
    run = VideoRun(source.count, frames=FrameStore(folder=out))
    live = online if isinstance(online, LiveFrames) else None
    with claimed(out / RECORDS), short_turns(AHEAD), rare_collections():
        records = _Records(source, out, frame_detector, motion, settings, live)
        run.before = len(records.stored)
        try:
            for record, frame in records.records():
                run.frames.append(follower(record))
                if not go_on(run, frame):
                    run.stopped = len(run.frames) < run.before or records.more_after(record.number)
                    break
        finally:
            records.close()
    run.delays = () if live is None else live.delays
    if not run.stopped:
        frames = [(head.number, head.time) for head in run.frames.heads]
        check_coverage(frames, *given)
        run.warnings = coverage_warnings(frames, source, *given)
        for line in run.warnings:
            warnings.warn(line, UncoveredFramesWarning, stacklevel=2)
    if not online:
        run.smooth(follower)
    return run


@dataclass(frozen=True)
class _RecordedFrame:
    """A frame on its way through the stages."""

    frame: SourceFrame
    record: FrameRecord | None  # what it shows; None of a frame that is read for the motion of the next one alone
    is_new: bool = False  # whether the record is new
    moved: bool = False  # whether its motion is
    motion: Future[CameraMotion | None] | None = None  # where it is estimated beside what the frame shows


_Boxed = tuple[SourceFrame, FrameRecord | None, Sequence[Sighting] | None]
"""A frame, what is stored of it, and its vehicles where nothing is."""


class _Records:
    """What is known of the frames: what runs before this one have stored, and what this one adds to it.

    Attributes:
        stored: The stored records.
    """

    def __init__(
        self,
        source: FrameSource,
        out: Path,
        frame_detector: FrameDetector,
        motion: MotionEstimator | None,
        settings: Mapping[str, Any],
        live: LiveFrames | None,
    ) -> None:
        self._source, self._frame_detector, self._motion = source, frame_detector, motion
        self._live, self._most = live, 0 if live else AHEAD
        # Live, a frame's motion is estimated while its keypoints are detected: it is there sooner.
        self._beside = ThreadPoolExecutor(1, "fgrecon motion") if live and motion else None
        self._reading: Iterator[SourceFrame] | None = None
        self._stages: Generator[_RecordedFrame] | None = None
        self._last_read = -1
        self._records = Parts(out / RECORDS, record_schema())
        self.stored = [from_row(row) for row in self._records.rows_in_order()]
        if isinstance(source, ImageFrames):  # only these have names; of a file the settings can tell whether it changed
            _check_still_there(self.stored, source, out)
        if motion is not None:
            begin(out / MOTIONS, {**settings, **motion.settings}, FORMAT, anew=lambda: True)
            self._motions = Parts(out / MOTIONS, motion_schema())
            self._moved = {row["row_id"]: motion_from_row(row) for row in self._motions.rows_in_order()}

    def close(self) -> None:
        """End the stages, and write what has been added."""
        try:
            if self._stages is not None:
                self._stages.close()
            if self._beside is not None:
                self._beside.shutdown()
        finally:
            self._records.flush()
            if self._motion is not None:
                self._motions.flush()

    def more_after(self, number: int) -> bool:
        """Whether a frame comes after this one, the last of `records`; it is read for it, since heads of files err."""
        if self._last_read > number:
            return True
        if (self._most or self._live) and self._stages is not None:
            return next(self._stages, None) is not None
        return next(self._reading or self._source.read(number), None) is not None

    def records(self) -> Iterator[tuple[FrameRecord, SourceFrame | None]]:
        """All records in order, each with its frame where that had to be read."""
        moving = self._motion
        whole = self.stored
        if moving is not None:
            whole = [replace(r, motion=self._moved[key]) for r in self.stored if (key := str(r.number)) in self._moved]
        yield from ((record, None) for record in whole)
        last = whole[-1].number if whole else None
        before = next((record for record in reversed(whole) if record.problem is None), None)
        # The motion since the last image needs that image.
        self._reading = self._source.read(last if moving is None or before is None else before.number - 1)
        read = self._noted(self._reading)
        frames = self._live(read, last) if self._live else made_ahead(read, self._most, "frames")
        boxed = made_ahead(self._boxed(frames, last, len(whole)), self._most, "boxes")
        recorded = made_ahead(self._recorded(boxed), self._most, "keypoints")
        moved = recorded if moving is None else self._moved_to(recorded, moving, before)
        self._stages = made_ahead(moved, 0 if moving is None else self._most, "motion")
        for one in self._stages:
            if one.record is None:
                continue
            if one.is_new:
                self._records.add(to_table(one.record))
            if one.moved:
                self._motions.add(motion_to_table(one.record))
            yield one.record, one.frame

    def _noted(self, frames: Iterator[SourceFrame]) -> Generator[SourceFrame]:
        for frame in frames:
            self._last_read = frame.number
            yield frame

    def _boxed(self, frames: Generator[SourceFrame], last: int | None, whole: int) -> Iterator[_Boxed]:
        """Frames with their vehicles, or what they show where that is stored; those up to the last one without."""
        known = {record.number: record for record in self.stored[whole:]}
        with closing(frames):
            for frame in frames:
                before = last is not None and frame.number <= last
                unknown = not before and frame.number not in known
                yield frame, known.get(frame.number), self._frame_detector.vehicles(frame) if unknown else None

    def _recorded(self, boxed: Generator[_Boxed]) -> Iterator[_RecordedFrame]:
        """Frames with what they show."""
        with closing(boxed):
            for frame, record, vehicles in boxed:
                if vehicles is None:
                    yield _RecordedFrame(frame, record)
                    continue
                beside = None
                if self._beside is not None and self._motion is not None:
                    beside = self._beside.submit(self._motion, frame, vehicles)
                record = self._frame_detector.record(frame, vehicles)
                yield _RecordedFrame(frame, record, is_new=True, motion=beside)

    def _moved_to(
        self, recorded: Generator[_RecordedFrame], moving: MotionEstimator, before: FrameRecord | None
    ) -> Iterator[_RecordedFrame]:
        """The same with the camera's motion since the frame before."""
        with closing(recorded):
            for one in recorded:
                yield self._with_motion(one, moving, before)

    def _with_motion(self, one: _RecordedFrame, moving: MotionEstimator, before: FrameRecord | None) -> _RecordedFrame:
        frame, record = one.frame, one.record
        if record is None:
            if before is not None and frame.number == before.number:
                moving.remember(frame, before)
            return one
        estimated = one.motion.result() if one.motion else None
        if (key := str(record.number)) in self._moved:  # whose record was damaged, and is made anew
            record = replace(record, motion=self._moved[key])
            moving.remember(frame, record)
            return replace(one, record=record)
        motion = estimated if one.motion else moving(frame, record.sightings)
        return replace(one, record=replace(record, motion=motion), moved=True)


def _check_still_there(stored: Sequence[FrameRecord], source: ImageFrames, out: Path) -> None:
    """Refuse images that do not begin with those that were looked at."""
    names = map(whole_text, source.names)  # as they are stored
    now = [f"frame {number} ({name})" for number, name in zip(source.numbers, names, strict=True)][: len(stored)]
    before = [f"frame {record.number} ({record.name})" for record in stored]
    for was, there in zip_longest(before, now, fillvalue="none"):
        if was != there:
            fix = f"Give another folder for these images: here {was} was looked at, where there is {there} now."
            raise InvalidInputError("out", str(out), f"{fix} Images may only be added after the last one.")
