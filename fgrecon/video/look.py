"""What a frame shows: boxes by the detector or given, keypoints by the networks or given, the camera's own motion."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.camera import Camera, Ground
from fgrecon.core.category import Category
from fgrecon.core.errors import InvalidInputError
from fgrecon.io.frames import SourceFrame
from fgrecon.perception.keypoints.detect import SMALLEST_BOX, check_box
from fgrecon.perception.protocols import KeypointDetector, VehicleDetector, find_keypoints, find_vehicles
from fgrecon.video.egomotion import CameraMotion, camera_motion
from fgrecon.video.records import FrameRecord, Sighting

__all__ = ["FrameLook"]


class FrameLook:
    """Looks at one frame after the other. With ego-motion it remembers the image before.

    Attributes:
        category: Category of the keypoints.
    """

    def __init__(
        self,
        category: Category,
        *,
        vehicle_detector: VehicleDetector | None = None,
        keypoint_detector: KeypointDetector | None = None,
        given: Mapping[int, Sequence[Sighting]] | None = None,
        moving: tuple[Camera, Ground] | None = None,
    ) -> None:
        """Take what looks.

        Args:
            category: Category of the keypoints.
            vehicle_detector: Finds the boxes where none are given.
            keypoint_detector: Finds the keypoints where none are given.
            given: Vehicles by the number of their frame, instead of the detector's.
            moving: Camera and ground, for the camera's motion to be estimated; None where it is not wanted.
        """
        self.category = category
        self._vehicles, self._keypoints, self._given, self._moving = vehicle_detector, keypoint_detector, given, moving
        self._before: tuple[NDArray[np.uint8], Sequence[NDArray[np.float64]]] | None = None
        self._motion: CameraMotion | None = None

    @property
    def remembers(self) -> bool:
        """Whether a frame's record depends on the one before."""
        return self._moving is not None

    def remember(self, frame: SourceFrame, record: FrameRecord) -> None:
        """Take the last frame that was looked at by a run before this one.

        Args:
            frame: The frame.
            record: What it showed.
        """
        if self._moving is not None and frame.image is not None:
            self._before = _grey(frame.image), [sighting.box for sighting in record.sightings]
            self._motion = record.motion

    def __call__(self, frame: SourceFrame) -> FrameRecord:
        """What a frame shows; one that cannot be read shows what was given for it.

        Raises:
            InvalidInputError: A detector returns something else than its protocol says.
        """
        if frame.image is None:
            kept = () if self._given is None else self._given.get(frame.number, ())
            seen = tuple(sighting for sighting in kept if sighting.observation is not None)
            return FrameRecord(frame.number, frame.time, frame.name, frame.problem, seen)
        sightings = self._sightings(frame.number, frame.image)
        motion = self._moved(frame.image, sightings)
        return FrameRecord(frame.number, frame.time, frame.name, None, tuple(sightings), motion)

    def _sightings(self, number: int, image: NDArray[np.uint8]) -> list[Sighting]:
        if self._given is not None:
            found = list(self._given.get(number, ()))
        else:
            assert self._vehicles is not None
            vehicles = find_vehicles(self._vehicles, image)
            each = zip(vehicles.boxes, vehicles.scores, vehicles.kinds or [None] * len(vehicles), strict=True)
            found = [Sighting(box, float(score), None, None, kind) for box, score, kind in each if _large(box)]
        limits = np.array([image.shape[1], image.shape[0]] * 2) - 1.0
        bare = [place for place, s in enumerate(found) if s.observation is None and _usable(s.box, image, limits)]
        boxes = np.array([np.clip(found[place].box, 0.0, limits) for place in bare]).reshape(-1, 4)
        if bare:
            assert self._keypoints is not None
            seen = find_keypoints(self._keypoints, image, boxes, self.category)
            for place, box, detection in zip(bare, boxes, seen, strict=True):
                one = found[place]
                found[place] = replace(one, box=box, observation=replace(detection.evidence, box=box))
        return found

    def _moved(self, image: NDArray[np.uint8], sightings: Sequence[Sighting]) -> CameraMotion | None:
        if self._moving is None:
            return None
        now = _grey(image), [sighting.box for sighting in sightings]
        before, self._before = self._before, now
        if before is None:
            return None
        guess = None if self._motion is None else self._motion.previous_T_current
        self._motion = camera_motion(before[0], now[0], *self._moving, before[1], now[1], guess)
        return self._motion


def _large(box: NDArray[np.float64]) -> bool:
    return bool((box[2:] - box[:2]).max() >= SMALLEST_BOX)


def _usable(box: NDArray[np.float64], image: NDArray[np.uint8], limits: NDArray[np.float64]) -> bool:
    """Whether the networks can look into a box: large enough, and enough of it in the image."""
    try:
        check_box(np.clip(box, 0.0, limits), image, "box")
    except InvalidInputError:
        return False
    return True


def _grey(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    import cv2

    grey: Any = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
    return np.asarray(grey, dtype=np.uint8)
