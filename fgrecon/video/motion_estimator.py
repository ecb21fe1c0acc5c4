"""The camera's own motion from frame to frame, image by image; the last one is remembered."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.camera import Camera, Ground
from fgrecon.io.source_frames import SourceFrame
from fgrecon.solve.threads import single_threaded
from fgrecon.video.egomotion import CameraMotion, camera_motion
from fgrecon.video.records import FrameRecord, Sighting


class MotionEstimator:
    """Estimates the camera's motion by points off the vehicles, frame by frame (`camera_motion`).

    Attributes:
        camera: The camera.
        ground: The ground in its frame, which tells how far it goes.
    """

    def __init__(self, camera: Camera, ground: Ground) -> None:
        """Begin without an image.

        Args:
            camera: The camera.
            ground: The ground in its frame.
        """
        self.camera, self.ground = camera, ground
        self._before: tuple[NDArray[np.uint8], list[NDArray[np.float64]]] | None = None
        self._motion: CameraMotion | None = None

    @property
    def settings(self) -> dict[str, Any]:
        """What motions depend on beside the images and the vehicles in them, as plain values."""
        lens = list(self.camera.lens_fields.values())
        return {
            "camera": [self.camera.matrix.tolist(), *(lens or [None])],
            "ground": [*self.ground.normal.tolist(), self.ground.distance, self.ground.slope_sigma],
        }

    def remember(self, frame: SourceFrame, record: FrameRecord) -> None:
        """Take a frame whose motion is known already.

        Args:
            frame: The frame.
            record: What it showed, with its motion.
        """
        if frame.image is not None:
            self._before, self._motion = _seen(frame.image, record.sightings), record.motion

    @single_threaded  # its numbers are the same whatever else runs
    def __call__(self, frame: SourceFrame, sightings: Sequence[Sighting]) -> CameraMotion | None:
        """The motion since the last frame that could be read.

        Args:
            frame: The frame.
            sightings: The vehicles that it shows, whose points do not count.

        Returns:
            The motion; None for the first frame, for one that cannot be read, and where the images do not tell.
        """
        if frame.image is None:
            return None
        now = _seen(frame.image, sightings)
        before, self._before = self._before, now
        if before is None:
            return None
        guess = None if self._motion is None else self._motion.previous_T_current
        self._motion = camera_motion(before[0], now[0], self.camera, self.ground, before[1], now[1], guess)
        return self._motion


def _seen(image: NDArray[np.uint8], sightings: Sequence[Sighting]) -> tuple[NDArray[np.uint8], list[NDArray[Any]]]:
    """The grey image, and the vehicles' boxes in it."""
    import cv2

    grey: Any = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
    return np.asarray(grey, dtype=np.uint8), [sighting.box for sighting in sightings]
