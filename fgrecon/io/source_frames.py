"""A frame of a video or of images; frames' numbers and times from the names of images; which frames are taken.

| images named by | number of a frame | its time, seconds |
|---|---|---|
| numbers (`000012.png`, `left_12.jpg`) | the last number of its name | - |
| times (`1311868164.363.png`, `cam0_1532402927612460.jpg`) | its place, from 0 | its name's |
| other things (words, dates, the same numbers again) | its place in the order of names, from 0 | - |

A time is a name of seconds with a fraction; or a last number that, in seconds or in thousandths, millionths or
billionths of them since 1970, lies between 1980, where GPS's clock begins, and 2100. Zeros before it make it a number.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.errors import InvalidInputError
from fgrecon.io.images import IMAGES


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
        left_out: Whether that is because nobody is to look at it, nor at what is given for it.
    """

    number: int
    time: float
    name: str
    image: NDArray[np.uint8] | None
    problem: str | None = None
    other_size: bool = False
    left_out: bool = False


def sized(frame: SourceFrame, size: tuple[int, ...] | None, name: str) -> SourceFrame:
    """The frame, a gap where its image is not of the size (H, W, 3), by the name of what it comes from."""
    if frame.image is None or size is None or frame.image.shape == size:
        return frame
    (height, width, _), (rows, columns, _) = frame.image.shape, size
    problem = f"{name}: {width} x {height} pixels, not {columns} x {rows}"
    return replace(frame, image=None, problem=problem, other_size=True)


@dataclass(frozen=True)
class Choice:
    """Which frames are taken."""

    every: int = 1  # every so many frames
    start: float = 0.0  # seconds after the first frame before which none is taken
    end: float | None = None  # seconds after the first frame from which on none is taken, or None

    def __post_init__(self) -> None:
        """Check the numbers."""
        if self.every < 1:
            raise InvalidInputError("every", self.every, "Give at least 1.")
        if not 0.0 <= self.start < np.inf:
            raise InvalidInputError("start", self.start, "Give seconds after the first frame, 0 or more.")
        if self.end is not None and not self.start < self.end < np.inf:
            raise InvalidInputError("end", self.end, f"Give seconds after the first frame, more than {self.start:g}.")

    def takes(self, place: int, seconds: float) -> bool:
        """Whether the frame of this place is taken, so many seconds after the first one."""
        return place % self.every == 0 and seconds >= self.start

    def ends(self, seconds: float) -> bool:
        """Whether none is taken any more, so many seconds after the first frame."""
        return self.end is not None and seconds >= self.end

    def chosen(self, passed: Sequence[float]) -> list[int]:
        """Places of the frames that are taken, by how many seconds after the first one each is."""
        taken = [place for place, seconds in enumerate(passed) if self.takes(place, seconds) and not self.ends(seconds)]
        if not taken:
            raise InvalidInputError("start", self.start, f"Give less: the frames last {passed[-1]:g} seconds.")
        return taken


DEFAULT_RATE = 10.0
"""Frames per second of images whose names tell no time, where nobody says."""

_UNITS = (1.0, 1e-3, 1e-6, 1e-9)  # seconds
_FIRST, _END = 315_964_800.0, 4_102_444_800.0  # 6 January 1980 and 1 January 2100, seconds since 1970
_SECONDS = re.compile(r"\d{1,18}\.\d+")  # by any clock
_STAMP = re.compile(r"(?<!\d)([1-9]\d{8,}(?:\.\d+)?)\D*$")
_DIGITS = 9  # of a frame's number: no video has more frames; a longer one is a date, or a clock's


@dataclass(frozen=True)
class OrderedImages:
    """Images in the order of their frames."""

    paths: tuple[Path, ...]  # the files
    numbers: tuple[int, ...]  # of the frames, growing
    times: tuple[float, ...] | None  # seconds, by the names; None where those tell none
    numbered: bool  # whether the names tell the numbers; else they are places


def frames_by_name(paths: Iterable[Path]) -> OrderedImages:
    """The images in order, with what all of their names tell."""
    known = sorted(paths)
    places = tuple(range(len(known)))
    times = [(seconds, path) for path in known if (seconds := seconds_of(path.stem)) is not None]
    if len(times) == len(known):
        times.sort()
        return OrderedImages(tuple(path for _, path in times), places, tuple(time for time, _ in times), numbered=False)
    numbers = [(number, path) for path in known if (number := number_of(path.stem)) is not None]
    numbers.sort()
    if len(numbers) == len(known) and all(a < b for (a, _), (b, _) in pairwise(numbers)):
        return OrderedImages(tuple(path for _, path in numbers), tuple(n for n, _ in numbers), None, numbered=True)
    return OrderedImages(tuple(known), places, None, numbered=False)


def times_of(numbers: Sequence[int], named: Sequence[float] | None, rate: float | None) -> tuple[Sequence[float], bool]:
    """Times of the frames, and whether they rest on frames per second that nobody gave.

    Raises:
        InvalidInputError: Names state them, and frames per second are given as well.
    """
    if named is None:
        return [number / (rate or DEFAULT_RATE) for number in numbers], rate is None
    if rate is not None:
        raise InvalidInputError("fps", rate, "Leave it out: the names of the images tell their times.")
    return named, False


def seconds_of(stem: str) -> float | None:
    """The time that a name without ending tells, or None."""
    if _SECONDS.fullmatch(stem) is not None:
        return float(stem)
    found = _STAMP.search(stem)
    times = () if found is None else (float(found[1]) * unit for unit in _UNITS)
    return next((time for time in times if _FIRST <= time < _END), None)


def number_of(stem: str) -> int | None:
    """The number of a frame that a name without ending tells: its last, unless that is a time; or None."""
    digits = re.findall(r"\d+", stem)
    if not digits or seconds_of(stem) is not None:
        return None
    last = digits[-1].lstrip("0") or "0"
    return int(last) if len(last) <= _DIGITS else None


def distinct_names(paths: Sequence[Path]) -> tuple[str, ...]:
    """The files' own names; where two have the same, with the folders in which they differ."""
    own = tuple(path.name for path in paths)
    if len(set(own)) == len(own):
        return own
    above = os.path.commonpath([path.parent for path in paths])
    return tuple(path.relative_to(above).as_posix() for path in paths)


def of_one_image(names: Iterable[str], image: str) -> set[str]:
    """Those of the names that mean an image: with or without its ending; else numbers that differ by zeros before them.

    Args:
        names: As files have them; folders before them do not matter.
        image: Name of the image, with its ending or without.
    """
    known = set(names)
    forms = _forms(image)
    same = {name for name in known if _forms(name) & forms}
    numbers = {form.lstrip("0") for form in forms if form.isdecimal()}
    return same or {name for name in known if numbers & {form.lstrip("0") for form in _forms(name) if form.isdecimal()}}


def _forms(name: str) -> set[str]:
    """The name of an image as it is, and without the ending of an image's file."""
    path = Path(name)
    return {path.name} | ({path.stem} if path.suffix.lower() in IMAGES else set())
