"""A frame of a video or of a folder of images, and the selection of frames."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.errors import InvalidInputError


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
        """Check the numbers.

        Raises:
            InvalidInputError: One is out of range.
        """
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
