"""Methods beside the picture alone on the labelled boxes of drives: with other sensors' evidence, and their rivals."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fgrecon.calibration.labelled_boxes import BoxOutcome, VideoBox
from fgrecon.calibration.labelled_frames import LookedFrame
from fgrecon.calibration.setup import SceneKnowledge
from fgrecon.core.camera import Camera
from fgrecon.core.geometry import yaw_rotation
from fgrecon.io.kitti_drives import Drive, DriveFrame
from fgrecon.perception.stereo import stereo_depth
from fgrecon_research.evaluation.point_baselines import score_baselines
from fgrecon_research.evaluation.run import ScoredRivals
from fgrecon_research.evaluation.sensed import score_sensed
from fgrecon_research.io.drive_sensors import Sensor, lidar_points, right_image

Array = NDArray[np.float64]

_EVERY = 2  # rows and columns of a depth map that baselines take


class OtherMethods:
    """Scores on each labelled box of a frame methods that get the keypoints, and methods that get other sensors."""

    def __init__(self, scene: SceneKnowledge, rivals: Sequence[str], sensors: Collection[Sensor]) -> None:
        """Take what is known of the scene.

        Raises:
            InvalidInputError: There is no method of a name.
        """
        self._rivals, self._sensors = ScoredRivals(scene, rivals), sensors

    def __call__(self, looked: LookedFrame) -> list[Mapping[str, BoxOutcome]]:
        """The outcomes of each box by the methods' names."""
        scored = [self._rivals(looked), score_sensed(looked, self._sensors)]
        if Sensor.LIDAR in self._sensors:
            scored.append(score_baselines(looked, lidar_points(looked.frame)))
        if Sensor.RIGHT in self._sensors:
            found = stereo_depth(looked.image, looked.camera, right_image(looked.frame))
            points = depth_points(found.depth[::_EVERY, ::_EVERY], looked.camera, _EVERY)
            scored.append(score_baselines(looked, points, "_stereo"))
        return [{name: one for part in parts for name, one in part.items()} for parts in zip(*scored, strict=True)]


def depth_points(depth: Array, camera: Camera, every: int = 1) -> Array:
    """(N, 3) points in the camera's frame of a depth map (H, W) that has every so many rows and columns of an image."""
    row, column = np.nonzero(np.isfinite(depth))
    return np.asarray(camera.rays(np.stack([column, row], axis=1) * float(every)) * depth[row, column, None])


def with_points(boxes: Sequence[VideoBox], drives: Sequence[Drive]) -> list[VideoBox]:
    """The boxes with how many points of the LiDAR are inside the labelled 3D box of each."""
    frames = {(drive.name, frame.number): frame for drive in drives for frame in drive.frames}
    counted: dict[tuple[str, int], Array] = {}
    found = []
    for box in boxes:
        key = box.drive, box.frame
        if key not in counted:
            counted[key] = lidar_points(frames[key]) - frames[key].calibration.label_offset
        found.append(replace(box, points=int(inside_label(frames[key], box.index, counted[key]).sum())))
    return found


def inside_label(frame: DriveFrame, index: int, points: Array) -> NDArray[np.bool_]:
    """(N,) which points (N, 3) in the frame of the labels are inside a labelled 3D box."""
    labels = frame.objects
    length, width, height = labels.size[index]
    local = (points - labels.location[index]) @ yaw_rotation(float(labels.rotation_y[index]))
    middle, half = np.array([0.0, -height / 2.0, 0.0]), np.array([length, height, width]) / 2.0
    inside: NDArray[np.bool_] = np.all(np.abs(local - middle) <= half, axis=1)
    return inside
