"""The camera frame by frame: its motion from image to image, and its poses, given or integrated from the motions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.arrays import Array
from fgrecon.core.camera import Camera, Ground
from fgrecon.core.geometry import rigid
from fgrecon.io.poses import CameraPoses
from fgrecon.io.source_frames import SourceFrame
from fgrecon.solve.threads import single_threaded
from fgrecon.video.egomotion import CameraMotion, camera_motion
from fgrecon.video.records import FrameRecord, Sighting


@dataclass(frozen=True)
class CameraPathSettings:
    """What is assumed of a motion that could not be estimated. Set by hand; not tuned.

    Attributes:
        max_coast_seconds: For which a camera is taken to go on as it did; then it has no pose.
        coast_sigma: Of the motion of a camera that goes on as it did: radians and metres in a second.
        lost_sigma: The same where nothing is known of it.
        least_seconds: The motion over a shorter time is not less unknown.
    """

    max_coast_seconds: float = 1.0
    coast_sigma: tuple[float, float] = (0.2, 5.0)
    lost_sigma: tuple[float, float] = (0.5, 20.0)
    least_seconds: float = 0.1


SETTINGS = CameraPathSettings()


class CameraPath:
    """The camera's poses: given ones, or the motions in the records one after the other.

    Where motions are missing the camera goes on as before for a second; from then on it has no pose, until the next.
    """

    def __init__(self, poses: CameraPoses | None = None, *, moving: bool = False) -> None:
        """Begin at the world's origin.

        Args:
            poses: The camera's poses, or None.
            moving: Whether it moves by the motions in the records; else it stays unknown without poses.
        """
        self.poses, self._moving = poses, moving
        self._pose: Array | None = None
        self._step: Array | None = None  # the last motion that was estimated, and how long it took
        self._passed = 0.0
        self._time: float | None = None
        self._skipped: CameraMotion | None = None  # the motion up to frames that were left out
        self._coasted = self._lost = 0.0  # seconds without a motion: with a pose, and without

    @property
    def known(self) -> bool:
        """Whether the camera has poses in some of the frames."""
        return self._moving or bool(self.poses)

    def skip(self, record: FrameRecord) -> None:
        """Leave a frame out; the next motion begins there all the same."""
        if not self._moving or record.problem is not None or self._pose is None:
            return
        if record.motion is None:
            self._skipped, self._lost = None, self._lost + SETTINGS.least_seconds
        else:
            self._skipped = self._since(record.motion)

    def _since(self, motion: CameraMotion) -> CameraMotion:
        """A motion, with that up to the frames that were left out before it."""
        return motion if self._skipped is None else self._skipped.then(motion)

    def move(self, record: FrameRecord) -> tuple[Array | None, Array | None, Array | None]:
        """The camera's pose, and how it came there.

        Returns:
            (4, 4) world_T_camera; (4, 4) previous_T_current since the last frame that has a pose; and the covariance
            (6, 6) of that, as `CameraMotion` has it, where it was estimated. None where not known.
        """
        before = self._pose
        if self.poses is not None:
            here = self.poses.at(record.number, record.time)
            if here is None:
                return None, None, None
            self._pose = here
            return here, None if before is None else np.asarray(np.linalg.inv(before) @ here), None
        if not self._moving or record.problem is not None:  # the next motion covers this frame as well
            return None, None, None
        passed = 0.0 if self._time is None else record.time - self._time
        self._time = record.time
        if before is None:
            self._pose = np.eye(4)
            return self._pose, None, None
        motion = None if record.motion is None else self._since(record.motion)
        self._skipped = None
        if motion is not None:
            step, covariance = (
                motion.previous_T_current,
                motion.covariance + _isotropic(SETTINGS.lost_sigma, self._lost),
            )
            self._step, self._passed, self._coasted, self._lost = step, passed, 0.0, 0.0
        elif self._step is not None and self._coasted + passed <= SETTINGS.max_coast_seconds:
            step = _scaled(self._step, passed / self._passed)
            covariance = _isotropic(SETTINGS.coast_sigma, max(passed, SETTINGS.least_seconds))
            self._coasted += passed
        else:
            self._step, self._lost = None, self._lost + passed
            return None, None, None
        self._pose = before @ step
        return self._pose, step, covariance


def _isotropic(sigmas: tuple[float, float], seconds: float) -> Array:
    """(6, 6) covariance of a motion by what is unknown of it in a second: radians, metres."""
    return np.diag(np.repeat(np.square(sigmas), 3)) * seconds**2


def _scaled(motion: Array, share: float) -> Array:
    """A motion that goes on for a share of its time."""
    from scipy.spatial.transform import Rotation

    turn = Rotation.from_rotvec(share * Rotation.from_matrix(motion[:3, :3]).as_rotvec()).as_matrix()
    return rigid(turn, share * motion[:3, 3])


class MotionEstimator:
    """Estimates the camera's motion by points off the vehicles, frame by frame (`camera_motion`)."""

    def __init__(self, camera: Camera, ground: Ground) -> None:
        """Begin without an image.

        Args:
            camera: The camera.
            ground: The ground in its frame, which tells how far it goes.
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
