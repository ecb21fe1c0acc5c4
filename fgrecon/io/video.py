"""Writing videos that browsers play: H.264, yuv420p, by PyAV; whole or not at all."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.errors import InvalidInputError, MissingPackageError
from fgrecon.io.files import check_ending, replacing

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
