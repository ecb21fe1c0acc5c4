"""The frames of a video file, by PyAV: one after the other, each by its place and the container's time.

Frames are never sought by their number: containers tell times, and where those are not even, or frames depend on later
ones, a seek ends elsewhere.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.errors import InvalidInputError, MissingPackageError
from fgrecon.io.frame_names import DEFAULT_RATE
from fgrecon.io.source_frames import Choice, SourceFrame, sized

VIDEOS = (".mp4", ".avi", ".mov", ".mkv", ".m4v", ".webm")
"""Endings of videos."""

_MISSING = 0.1  # share of a video's duration, as its head tells it, of which no frame came


@dataclass(frozen=True)
class VideoFrames:
    """A video's frames."""

    path: Path  # the file
    # about how many frames are taken, by its head, which often tells something else than there is: for progress
    # alone. None where it tells nothing
    count: int | None
    choice: Choice  # which frames are taken
    lasts: float | None = None  # seconds, as its head tells; None where it does not
    assumed_rate: bool = False

    @property
    def first_file(self) -> Path:
        """The file itself."""
        return self.path

    def read(self, after: int | None = None) -> Iterator[SourceFrame]:
        """The frames in order, from the first with a number above `after`; those before are decoded all the same.

        Gaps are frames that the decoder calls damaged, those of another size than the first, and the end of a file that
        breaks off.
        """
        first: float | None = None
        size: tuple[int, ...] | None = None
        for one in _decoded(self.path, self.lasts):
            first = one.time if first is None else first
            if self.choice.ends(one.time - first):
                return
            taken = self.choice.takes(one.number, one.time - first) and (after is None or one.number > after)
            if taken or (size is None and one.picture is not None):
                name = f"{self.path.name}#{one.number}"
                image = None if one.picture is None else _upright(one.picture)
                size = image.shape if size is None and image is not None else size
                if taken:
                    frame = SourceFrame(one.number, one.time, name, image, one.problem)
                    yield sized(frame, size, f"{self.path.name}: frame {one.number}")


@dataclass(frozen=True, eq=False)
class _Decoded:
    """What the decoder gave: a frame's number, its seconds, PyAV's picture or None, and why there is none."""

    number: int
    time: float
    picture: Any
    problem: str | None


def open_video(path: Path, choice: Choice) -> VideoFrames:
    """What the head of a video tells; no frame is decoded yet.

    Raises:
        InvalidInputError: It is no video that FFmpeg reads.
        MissingPackageError: PyAV is not installed.
    """
    with _opened(path) as container:
        stream = container.streams.video[0]
        rate, known, lasts = stream.average_rate or stream.guessed_rate, stream.frames, _duration(container)
    if not known and rate and lasts:
        known = round(lasts * float(rate))
    if not known:
        return VideoFrames(path, None, choice, lasts)
    last = known if choice.end is None or not rate else min(known, round(choice.end * float(rate)))
    first = round(choice.start * float(rate)) if rate else 0
    return VideoFrames(path, max(-(-last // choice.every) - -(-first // choice.every), 0), choice, lasts)


def count_frames(path: Path) -> int:
    """How many frames a video has, by its packets (`packet_times`)."""
    return len(packet_times(path))


def packet_times(path: Path) -> list[float]:
    """Seconds of each packet of a video, in the file's order, NaN where it tells none; none is decoded.

    A frame is one packet, so that there are not more frames than these.

    Raises:
        InvalidInputError: It is no video that FFmpeg reads.
        MissingPackageError: PyAV is not installed.
    """
    times: list[float] = []
    with _opened(path) as container:
        try:
            packets = (packet for packet in container.demux(container.streams.video[0]) if packet.size > 0)
            times.extend(np.nan if one.pts is None else float(one.pts * one.time_base) for one in packets)
        except _av().error.FFmpegError:  # the file breaks off: what is missing is no frame
            pass
    return times


def _decoded(path: Path, lasts: float | None) -> Iterator[_Decoded]:
    """Every frame of a video in the order of their times, broken ones among them; and where the file breaks off."""
    av = _av()
    with _opened(path) as container:
        stream = container.streams.video[0]
        step = 1.0 / float(stream.average_rate or DEFAULT_RATE)
        start = 0.0 if container.start_time is None else container.start_time / av.time_base
        number, time = -1, start - step
        lost: list[tuple[float, str]] = []  # packets that were not decoded: frames are shown in another order than that
        packets, end = container.demux(stream), None
        while end is None:
            pictures: list[Any] = []
            packet = None
            try:
                packet = next(packets, None)
                end = "" if packet is None else None
                pictures = [] if packet is None else packet.decode()
            except av.error.FFmpegError as error:
                if packet is None:
                    end = str(error.strerror)
                else:
                    later = time + step if packet.pts is None else float(packet.pts * packet.time_base)
                    lost = sorted([*lost, (later, str(error.strerror))])
            for picture in pictures:
                seconds = time + step if picture.time is None else picture.time
                while lost and lost[0][0] < seconds:
                    number, (time, problem) = number + 1, lost.pop(0)
                    yield _Decoded(number, time, None, f"{path.name}: frame {number}: {problem}")
                number, time = number + 1, seconds
                damaged = f"{path.name}: frame {number}: damaged" if picture.is_corrupt else None
                yield _Decoded(number, time, None if damaged else picture, damaged)
        for time, problem in lost:
            number += 1
            yield _Decoded(number, time, None, f"{path.name}: frame {number}: {problem}")
        missing = 0.0 if lasts is None else start + lasts - (time + step)
        if not end and lasts is not None and missing > max(_MISSING * lasts, step):
            end = f"the file breaks off, {missing:.1f} of {lasts:.1f} seconds before its end"
        if end:
            number, time = number + 1, time + step
            yield _Decoded(number, time, None, f"{path.name}: frame {number}: {end}")


def _duration(container: Any) -> float | None:
    """Seconds, by the pictures themselves where their stream tells it."""
    stream = container.streams.video[0]
    if stream.duration:
        return float(stream.duration * stream.time_base)
    return container.duration / _av().time_base if container.duration else None


def _opened(path: Path) -> Any:
    """PyAV's container of a file with pictures."""
    av = _av()
    try:
        container = av.open(str(path))
    except av.error.FFmpegError as error:
        fix = f"Give a video that FFmpeg reads ({error.strerror})."
        raise InvalidInputError("source", str(path), fix) from error
    if not container.streams.video:
        container.close()
        raise InvalidInputError("source", str(path), "Give a video: this file has no pictures.")
    return container


def _upright(picture: Any) -> NDArray[np.uint8]:
    """The pixels (H, W, 3), turned as the container says they are to be shown."""
    pixels: NDArray[np.uint8] = picture.to_ndarray(format="rgb24")
    turns = round(getattr(picture, "rotation", 0) / 90.0) % 4
    return np.ascontiguousarray(np.rot90(pixels, turns))


def _av() -> Any:
    try:
        import av
    except ImportError as error:
        raise MissingPackageError("av>=14", "Reading a video") from error
    return av
