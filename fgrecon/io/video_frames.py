"""Video files, by PyAV: frames read one after the other, and videos written that browsers play (H.264, yuv420p).

Frames are never sought by their number: containers tell times, and where those are not even, or frames depend on later
ones, a seek ends elsewhere.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.errors import InvalidInputError, MissingPackageError
from fgrecon.io.files import check_ending, replacing
from fgrecon.io.source_frames import DEFAULT_RATE, Choice, SourceFrame, sized

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


VIDEO_FORMATS = {"mp4": "mp4", "mkv": "matroska", "mov": "mov"}
"""FFmpeg's name of the container by the ending of the file's name."""

_CODEC = "libx264"
_CLOCK = Fraction(1, 90_000)  # seconds; every usual rate is a multiple
_QUALITY = {"crf": "20", "preset": "veryfast"}


def check_video(path: str | Path) -> str:
    """The container of a video that is to be written, before the work that it shows.

    Raises:
        InvalidInputError: Another ending, or this PyAV has no encoder of H.264.
        MissingPackageError: PyAV is not installed.
    """
    kind = check_ending(path, tuple(VIDEO_FORMATS))
    try:
        import av
    except ImportError as error:
        raise MissingPackageError("av>=14", "Writing a video") from error
    try:
        av.Codec(_CODEC, "w")
    except ValueError as error:  # av.codec.codec.UnknownCodecError
        fix = "Install PyAV from its own wheels (pip install --force-reinstall av), or write no video."
        raise InvalidInputError(str(path), f"a PyAV without the codec {_CODEC}", fix) from error
    return VIDEO_FORMATS[kind]


@contextmanager
def write_video(path: str | Path, *, rate: float) -> Iterator[Callable[[NDArray[np.uint8], float | None], None]]:
    """A function that takes the frames; the file is in its place at the end, and not at all after an error.

    The function is called with an image (H, W, 3) of RGB bytes, all of one size, of which an odd last row or column is
    left away, and with its time in seconds; without a time frames follow each other at the rate.

    Args:
        path: `.mp4`, `.mkv` or `.mov` file.
        rate: Frames per second.

    Raises:
        InvalidInputError: As `check_video`, the file cannot be written, times do not grow, or a size differs or is too
            small.
        MissingPackageError: PyAV is not installed.
    """
    container_format = check_video(path)
    import av

    with replacing(path) as part, av.open(str(part), "w", format=container_format) as container:
        film = _Film(container, Fraction(rate).limit_denominator(1001))
        yield film.add
        film.end()


class _Film:
    """The stream of a container, made at its first frame, which tells the size."""

    def __init__(self, container: Any, rate: Fraction) -> None:
        self._container, self._rate = container, rate
        self._stream: Any = None
        self._ticks = -1
        self._count = 0
        self._first: float | None = None

    def add(self, image: NDArray[np.uint8], time: float | None = None) -> None:
        import av

        height, width = (side - side % 2 for side in image.shape[:2])  # the codec wants even sides
        if min(height, width) == 0:
            have = f"{image.shape[1]} x {image.shape[0]}"
            raise InvalidInputError("video", f"frames of {have} pixels", "Give at least 2 x 2.")
        if self._stream is None:
            options = {"movflags": "+faststart"}  # the head first, so that it plays while it loads
            self._container.options.update(options)
            self._stream = self._container.add_stream(_CODEC, rate=self._rate, options=_QUALITY)
            self._stream.width, self._stream.height, self._stream.pix_fmt = width, height, "yuv420p"
            self._stream.codec_context.time_base = _CLOCK
        if (self._stream.width, self._stream.height) != (width, height):
            have = f"{self._stream.width} x {self._stream.height}"
            raise InvalidInputError("image", f"{width} x {height} after {have}", "Give frames of one size.")
        self._first = time if self._first is None else self._first
        seconds = self._count / self._rate if time is None or self._first is None else time - self._first
        ticks = round(seconds / _CLOCK)
        if ticks <= self._ticks:
            raise InvalidInputError("time", time, "Give times that grow.")
        self._ticks, self._count = ticks, self._count + 1
        frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(image[:height, :width]), format="rgb24")
        frame.pts, frame.time_base = ticks, _CLOCK
        self._container.mux(self._stream.encode(frame))

    def end(self) -> None:
        if self._stream is None:
            raise InvalidInputError("frames", "none", "Give at least one.")
        self._container.mux(self._stream.encode())
