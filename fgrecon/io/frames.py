"""The frames of a video, or of a folder of images: numbered, timed, one after the other; a broken one is a gap.

| input | number of a frame | its time, seconds |
|---|---|---|
| a video | its place, from 0 | the container's |
| images | by their names (`fgrecon.io.frame_names`) | by their names, else number / frames per second |

Numbers may be missing: time goes on there. Images are of one camera, and so of one size: that of the first that can be
read.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from glob import glob
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.errors import InvalidInputError, MissingPackageError
from fgrecon.io.frame_names import DEFAULT_RATE, distinct_names, frames_by_name, times_of
from fgrecon.io.images import IMAGES, read_image

__all__ = [
    "DEFAULT_RATE",
    "VIDEOS",
    "FrameSource",
    "ImageFrames",
    "NumberedFrames",
    "SourceFrame",
    "VideoFrames",
    "numbered_frames",
    "open_frames",
]

VIDEOS = (".mp4", ".avi", ".mov", ".mkv", ".m4v", ".webm")
"""Endings of videos."""

_LEFT_COLOUR = ("image_02", "image_2")


@dataclass(frozen=True, eq=False)
class SourceFrame:
    """One frame.

    Attributes:
        number: Within its source; numbers grow, and some may be missing.
        time: Seconds, by the source's clock.
        name: Of its file, or of the video with the number; no other frame has it.
        image: (H, W, 3) RGB bytes; None where it cannot be used.
        problem: Why not, or None.
        other_size: Whether that is because it has another size than the first, and so another camera.
    """

    number: int
    time: float
    name: str
    image: NDArray[np.uint8] | None
    problem: str | None = None
    other_size: bool = False


@dataclass(frozen=True)
class _Choice:
    """Which frames are taken.

    Attributes:
        every: Every so many frames.
        start: Seconds after the first frame before which none is taken.
        end: Seconds after the first frame from which on none is taken, or None.
    """

    every: int
    start: float
    end: float | None

    def takes(self, place: int, seconds: float) -> bool:
        return place % self.every == 0 and seconds >= self.start

    def ends(self, seconds: float) -> bool:
        return self.end is not None and seconds >= self.end


@dataclass(frozen=True)
class ImageFrames:
    """Images as frames.

    Attributes:
        paths: The files.
        names: Of each, no two alike.
        numbers: Of each.
        times: Of each, seconds.
        numbered: Whether the names tell the numbers; else they are places.
        assumed_rate: Whether the times rest on frames per second that nobody gave.
    """

    paths: tuple[Path, ...]
    names: tuple[str, ...]
    numbers: tuple[int, ...]
    times: tuple[float, ...]
    numbered: bool
    assumed_rate: bool = False

    @property
    def first_file(self) -> Path:
        """The file of the first frame, which tells where calibrations may lie."""
        return self.paths[0]

    @property
    def count(self) -> int:
        """How many there are."""
        return len(self.paths)

    def read(self, after: int | None = None) -> Iterator[SourceFrame]:
        """The frames in order, from the first with a number above `after`; those of another size are gaps."""
        size: tuple[int, ...] | None = None
        for path, name, number, time in zip(self.paths, self.names, self.numbers, self.times, strict=True):
            wanted = after is None or number > after
            if wanted or size is None:
                frame = _of_file(path, name, number, time, size)
                if frame.image is not None:
                    size = frame.image.shape
                if wanted:
                    yield frame


def _of_file(path: Path, name: str, number: int, time: float, size: tuple[int, ...] | None) -> SourceFrame:
    """An image as a frame; a gap where it cannot be read, or has another size than that."""
    try:
        image = read_image(path)
    except InvalidInputError as error:
        return SourceFrame(number, time, name, None, str(error))
    if size is None or image.shape == size:
        return SourceFrame(number, time, name, image)
    (height, width, _), (rows, columns, _) = image.shape, size
    problem = f"{path}: {width} x {height} pixels, not {columns} x {rows}"
    return SourceFrame(number, time, name, None, problem, other_size=True)


@dataclass(frozen=True)
class VideoFrames:
    """A video's frames.

    Attributes:
        path: The file.
        count: How many frames its head tells that are taken; None where it does not.
        choice: Which frames are taken.
    """

    path: Path
    count: int | None
    choice: _Choice
    assumed_rate: bool = False

    @property
    def first_file(self) -> Path:
        """The file itself."""
        return self.path

    def read(self, after: int | None = None) -> Iterator[SourceFrame]:
        """The frames in order, from the first with a number above `after`; those before are decoded all the same.

        Frames that the decoder calls damaged are gaps, and so is where the file breaks off.
        """
        first: float | None = None
        for number, time, picture, problem in _decoded(self.path):
            first = time if first is None else first
            if self.choice.ends(time - first):
                return
            if self.choice.takes(number, time - first) and (after is None or number > after):
                image = None if picture is None else _upright(picture)
                yield SourceFrame(number, time, f"{self.path.name}#{number}", image, problem)


@dataclass(frozen=True)
class NumberedFrames:
    """Frames of which there are no images, but vehicles that others have found.

    Attributes:
        path: The file that tells their numbers.
        numbers: Of each.
        times: Of each, seconds.
        assumed_rate: Whether the times rest on frames per second that nobody gave.
    """

    path: Path
    numbers: tuple[int, ...]
    times: tuple[float, ...]
    assumed_rate: bool = False

    @property
    def first_file(self) -> Path:
        """The file that tells their numbers."""
        return self.path

    @property
    def count(self) -> int:
        """How many there are."""
        return len(self.numbers)

    def read(self, after: int | None = None) -> Iterator[SourceFrame]:
        """The frames in order, without images, from the first with a number above `after`."""
        for number, time in zip(self.numbers, self.times, strict=True):
            if after is None or number > after:
                yield SourceFrame(number, time, f"{self.path.name}#{number}", None)


FrameSource = ImageFrames | VideoFrames | NumberedFrames
"""Frames, whatever they are made of."""


def open_frames(
    source: str | Path,
    *,
    rate: float | None = None,
    every: int = 1,
    start: float = 0.0,
    end: float | None = None,
) -> FrameSource:
    """Find the frames of a video, a folder or a pattern such as `drive/*.png`; none is opened yet.

    Args:
        source: A video, a folder of images (or of KITTI's layout, with `image_02`), or a pattern of images.
        rate: Frames per second of images whose names tell no times; None assumes 10. A video has times of its own.
        every: Take every so many frames.
        start: Seconds after the first frame before which none is taken.
        end: Seconds after the first frame from which on none is taken.

    Raises:
        InvalidInputError: There is nothing of this kind, a number is out of range, or no frame is left.
        MissingPackageError: It is a video, and PyAV is not installed.
    """
    choice = _chosen(rate, every, start, end)
    path = Path(source)
    if path.is_file() and path.suffix.lower() in VIDEOS:
        if rate is not None:
            raise InvalidInputError("fps", rate, "Leave it out: a video has times of its own.")
        return _video(path, choice)
    return _images(_files(str(source)), rate, choice)


def numbered_frames(
    path: Path,
    numbers: Iterable[int],
    *,
    times: Mapping[int, float] | None = None,
    rate: float | None = None,
    every: int = 1,
    start: float = 0.0,
    end: float | None = None,
) -> NumberedFrames:
    """Frames without images; the arguments are those of `open_frames`.

    Args:
        path: The file that tells their numbers.
        numbers: Of the frames.
        times: Seconds by number, where they are known.
        rate: Frames per second where they are not; None assumes 10.
        every: Take every so many frames.
        start: Seconds after the first frame before which none is taken.
        end: Seconds after the first frame from which on none is taken.

    Raises:
        InvalidInputError: A number is out of range, or no frame is left.
    """
    choice = _chosen(rate, every, start, end)
    ordered = sorted(numbers)
    seconds, assumed = times_of(ordered, None if times is None else [times[number] for number in ordered], rate)
    taken = _taken(seconds, choice)
    return NumberedFrames(path, tuple(ordered[i] for i in taken), tuple(seconds[i] for i in taken), assumed)


def _chosen(rate: float | None, every: int, start: float, end: float | None) -> _Choice:
    if rate is not None and not (np.isfinite(rate) and rate > 0):
        raise InvalidInputError("fps", rate, "Give a positive number of frames per second.")
    if every < 1:
        raise InvalidInputError("every", every, "Give at least 1.")
    if start < 0 or (end is not None and end <= start):
        raise InvalidInputError(
            "end" if start >= 0 else "start", end if start >= 0 else start, "Give 0 <= start < end."
        )
    return _Choice(every, start, end)


def _files(source: str) -> list[Path]:
    """The images of a folder or pattern."""
    path = Path(source)
    if path.is_dir():
        folder = next((path / name for name in _LEFT_COLOUR if (path / name).is_dir()), path)
        found = [p for p in folder.iterdir() if p.is_file() and not p.name.startswith(".")]
    elif path.is_file():
        found = [path]
    else:
        found = [Path(name) for name in glob(source)]  # noqa: PTH207 - the pattern may be absolute
    images = [p for p in found if p.suffix.lower() in IMAGES]
    if not images:
        fix = f"Give a video ({', '.join(VIDEOS)}), a folder of images, or a pattern that finds images."
        known = path.exists() or set(source) & set("*?[")
        raise InvalidInputError("source", source, fix if known else f"There is no such file or folder. {fix}")
    return images


def _images(paths: Sequence[Path], rate: float | None, choice: _Choice) -> ImageFrames:
    found = frames_by_name(paths)
    names = distinct_names(found.paths)
    times, assumed = times_of(found.numbers, found.times, rate)
    taken = _taken(times, choice)
    return ImageFrames(
        tuple(found.paths[i] for i in taken),
        tuple(names[i] for i in taken),
        tuple(found.numbers[i] for i in taken),
        tuple(times[i] for i in taken),
        found.numbered,
        assumed,
    )


def _taken(times: Sequence[float], choice: _Choice) -> list[int]:
    """Which frames are taken, by their place."""
    passed = [time - times[0] for time in times]
    taken = [place for place, time in enumerate(passed) if choice.takes(place, time) and not choice.ends(time)]
    if not taken:
        raise InvalidInputError("start", choice.start, f"Give less: the frames last {passed[-1]:g} seconds.")
    return taken


def _video(path: Path, choice: _Choice) -> VideoFrames:
    av = _av()
    try:
        with av.open(str(path)) as container:
            if not container.streams.video:
                raise InvalidInputError("source", str(path), "Give a video: this file has no pictures.")
            stream = container.streams.video[0]
            rate = stream.average_rate or stream.guessed_rate
            known = stream.frames
            if not known and rate and container.duration:
                known = round(container.duration / av.time_base * float(rate))
    except av.error.FFmpegError as error:
        fix = f"Give a video that FFmpeg reads ({error.strerror})."
        raise InvalidInputError("source", str(path), fix) from error
    if not known:
        return VideoFrames(path, None, choice)
    last = known if choice.end is None or not rate else min(known, round(choice.end * float(rate)))
    first = round(choice.start * float(rate)) if rate else 0
    return VideoFrames(path, max(-(-last // choice.every) - -(-first // choice.every), 0), choice)


def _decoded(path: Path) -> Iterator[tuple[int, float, Any, str | None]]:
    """Number, time, picture or None, and what is wrong with it, of every frame of a video."""
    av = _av()
    broken = av.error.FFmpegError
    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        step = 1.0 / float(stream.average_rate or DEFAULT_RATE)
        number, time = -1, -step
        packets = container.demux(stream)
        while True:
            try:
                packet = next(packets, None)
                if packet is None:
                    return
                pictures = packet.decode()
            except broken as error:
                number, time = number + 1, time + step
                yield number, time, None, f"{path.name}: frame {number}: {error.strerror}"
                if packet is None:  # the file breaks off
                    return
                continue
            for picture in pictures:
                number, time = number + 1, time + step if picture.time is None else picture.time
                damaged = f"{path.name}: frame {number}: damaged" if picture.is_corrupt else None
                yield number, time, None if damaged else picture, damaged


def _upright(picture: Any) -> NDArray[np.uint8]:
    """The pixels (H, W, 3), turned as the container says they are to be shown."""
    pixels: NDArray[np.uint8] = picture.to_ndarray(format="rgb24")
    turns = round(getattr(picture, "rotation", 0) / 90.0) % 4
    return np.ascontiguousarray(np.rot90(pixels, turns))


def _av() -> Any:
    try:
        import av
    except ImportError as error:
        raise MissingPackageError("fgrecon[video]", "Reading a video") from error
    return av
