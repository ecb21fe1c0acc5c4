"""The images of tasks: files, bytes, and frames of videos."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.camera import Camera
from fgrecon.core.errors import InvalidInputError
from fgrecon.io.images import decode_photograph, read_photograph

if TYPE_CHECKING:
    from fgrecon.io.source_frames import SourceFrame

__all__ = ["Pictures"]


class Pictures:
    """Opens images; the video that was read last stays open, since a later frame of it is probably wanted next."""

    def __init__(self) -> None:
        """Nothing is open yet."""
        self._path: str | None = None
        self._frames: Iterator[SourceFrame] = iter(())
        self._next = 0

    def get(self, image: str | bytes, frame: int | None = None) -> tuple[NDArray[np.uint8], Camera | None]:
        """An image (H, W, 3) of RGB bytes, and the camera that its EXIF data tell, or None.

        Args:
            image: File of an image, or of a video where a frame is given; or the bytes of an image file.
            frame: Number of the frame from 0.

        Raises:
            InvalidInputError: It cannot be read.
        """
        if isinstance(image, bytes):
            return decode_photograph(image, "image")
        if "\0" in image:
            raise InvalidInputError("image", image, "Give the name of a file: none has a null character.")
        return read_photograph(image) if frame is None else (self._frame(image, frame), None)

    def _frame(self, path: str, frame: int) -> NDArray[np.uint8]:
        from fgrecon.io.source_frames import Choice
        from fgrecon.io.video_frames import open_video

        if path != self._path or frame < self._next:
            self._path, self._frames = path, open_video(Path(path), Choice()).read(after=frame - 1)
        self._next = frame + 1
        found = next((one for one in self._frames if one.number == frame), None)
        if found is None or found.image is None:
            problem = f"{path}: it has no frame {frame}" if found is None else found.problem
            raise InvalidInputError("image", path, f"Give a whole video ({problem}).")
        return found.image
