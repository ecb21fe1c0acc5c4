"""The frames of a video, or of a folder of images: numbered, timed, one after the other; a broken one is a gap.

| input | number of a frame | its time, seconds |
|---|---|---|
| a video | its place, from 0 | the container's |
| a bag's topic | its message, from 0 | the header's (`fgrecon.io.bag_drive`) |
| images | by their names (`fgrecon.io.source_frames`) | by their names, else number / frames per second |

Numbers may be missing: time goes on there. Images are of one camera, and so of one size: that of the first that can be
read.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from glob import glob
from pathlib import Path

import numpy as np

from fgrecon.core.errors import InvalidInputError
from fgrecon.io.bag_images import BagFrames
from fgrecon.io.images import IMAGES, read_image, refuse_unread
from fgrecon.io.source_frames import Choice, OrderedImages, SourceFrame, distinct_names, frames_by_name, sized, times_of
from fgrecon.io.video_frames import VIDEOS, VideoFrames, open_video

_LEFT_COLOUR = ("image_02", "image_2")


@dataclass(frozen=True)
class ImageFrames:
    """Images as frames."""

    paths: tuple[Path, ...]  # the files
    names: tuple[str, ...]  # of each, no two alike
    numbers: tuple[int, ...]
    times: tuple[float, ...]  # of each, seconds
    numbered: bool  # whether the names tell the numbers; else they are places
    assumed_rate: bool = False  # whether the times rest on frames per second that nobody gave
    left_out: frozenset[int] = frozenset()  # numbers of the images that were not chosen

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
    return sized(SourceFrame(number, time, name, image), size, str(path))


@dataclass(frozen=True)
class NumberedFrames:
    """Frames of which there are no images, but vehicles that others have found."""

    path: Path  # the file that tells their numbers
    numbers: tuple[int, ...]
    times: tuple[float, ...]  # of each, seconds
    assumed_rate: bool = False  # whether the times rest on frames per second that nobody gave

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


FrameSource = ImageFrames | VideoFrames | NumberedFrames | BagFrames
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
    _check_rate(rate)
    choice = Choice(every, start, end)
    path = Path(source)
    if path.is_file() and path.suffix.lower() in VIDEOS:
        if rate is not None:
            raise InvalidInputError("fps", rate, "Leave it out: a video has times of its own.")
        return open_video(path, choice)
    return _chosen(frames_by_name(_files(str(source))), rate, choice)


def numbered_frames(
    path: Path,
    numbers: Iterable[int],
    choice: Choice,
    *,
    times: Mapping[int, float] | None = None,
    rate: float | None = None,
) -> NumberedFrames:
    """Those of a choice of frames without images.

    Args:
        times: Seconds by number, where they are known.
        rate: Frames per second where they are not; None assumes 10.

    Raises:
        InvalidInputError: The rate is not positive, or no frame is left.
    """
    _check_rate(rate)
    ordered = sorted(numbers)
    seconds, assumed = times_of(ordered, None if times is None else [times[number] for number in ordered], rate)
    taken = choice.chosen([time - seconds[0] for time in seconds])
    return NumberedFrames(path, tuple(ordered[i] for i in taken), tuple(seconds[i] for i in taken), assumed)


def _check_rate(rate: float | None) -> None:
    if rate is not None and not (np.isfinite(rate) and rate > 0):
        raise InvalidInputError("fps", rate, "Give a positive number of frames per second.")


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
        refuse_unread(path, "source")
        fix = (
            f"Give a video ({', '.join(VIDEOS)}), a folder of images, a pattern that finds images, a data set or a bag."
        )
        known = path.exists() or set(source) & set("*?[")
        raise InvalidInputError("source", source, fix if known else f"There is no such file or folder. {fix}")
    return images


def timed_frames(paths: Sequence[Path], times: Sequence[float], choice: Choice) -> ImageFrames:
    """Those of a choice of images as frames, numbered by their places, whose times are known.

    Raises:
        InvalidInputError: No frame is left.
    """
    found = OrderedImages(tuple(paths), tuple(range(len(paths))), tuple(times), numbered=False)
    return _chosen(found, None, choice)


def _chosen(found: OrderedImages, rate: float | None, choice: Choice) -> ImageFrames:
    names = distinct_names(found.paths)
    times, assumed = times_of(found.numbers, found.times, rate)
    taken = choice.chosen([time - times[0] for time in times])
    return ImageFrames(
        tuple(found.paths[i] for i in taken),
        tuple(names[i] for i in taken),
        tuple(found.numbers[i] for i in taken),
        tuple(times[i] for i in taken),
        found.numbered,
        assumed,
        frozenset(found.numbers).difference(found.numbers[i] for i in taken),
    )
