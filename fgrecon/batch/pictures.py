"""The images of tasks: files, bytes, and frames of videos."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.camera import Camera
from fgrecon.core.errors import InvalidInputError
from fgrecon.io.images import decode_photograph, read_photograph

__all__ = ["Pictures", "count_frames"]


class Pictures:
    """Opens images; the video that was read last stays open, since its next frame is probably wanted next."""

    def __init__(self) -> None:
        """Nothing is open yet."""
        self._path: str | None = None
        self._video: Any = None
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
        import cv2

        if path != self._path:
            self.close()
            self._path, self._video, self._next = path, cv2.VideoCapture(path), 0
        if frame != self._next:
            self._video.set(cv2.CAP_PROP_POS_FRAMES, frame)
        good, pixels = self._video.read()
        self._next = frame + 1
        if not good:
            self.close()
            fix = f"Give a video that OpenCV reads, whole: it does not read frame {frame}."
            raise InvalidInputError("image", path, fix)
        return np.ascontiguousarray(pixels[..., ::-1], dtype=np.uint8)

    def close(self) -> None:
        """Close the video."""
        if self._video is not None:
            self._video.release()
        self._path, self._video = None, None


def count_frames(path: Path) -> int:
    """How many frames a video has, by its head; where that does not say, by going through it.

    Raises:
        InvalidInputError: It is no video that OpenCV reads.
    """
    import cv2

    video: Any = cv2.VideoCapture(str(path))
    try:
        if not video.isOpened():
            raise InvalidInputError("video", str(path), "Give a video that OpenCV reads, such as MP4 or AVI.")
        told = int(video.get(cv2.CAP_PROP_FRAME_COUNT))
        if told > 0:
            return told
        count = 0
        while video.grab():
            count += 1
        return count
    finally:
        video.release()
