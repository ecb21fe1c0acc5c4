"""Evaluation of other sensors' evidence on the labelled boxes of drives, beside the picture alone and rivals.

| method | what it gets beside the picture |
|---|---|
| `lidar` | the scan |
| `lidar/4`, `lidar/16` | every so-many-th point of it |
| `lidar_turned` | the scan half a degree off, about an axis chosen by chance for each frame |
| `stereo` | the right image |
| `depth` | a depth map of the scan's points, and of the right image's disparities elsewhere where there is one |
| `depth_affine` | the same map times a number, and plus one, which are chosen by chance for each frame |
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgrecon.calibration.labelled_boxes import BoxOutcome, VideoBox
from fgrecon.calibration.labelled_frames import ReconstructedFrame, SceneKnowledge, found_outcome
from fgrecon.core.arrays import Array
from fgrecon.core.camera import Camera
from fgrecon.core.choices import DepthScale
from fgrecon.core.depth_map import DepthMap
from fgrecon.core.evidence import Evidence, Points
from fgrecon.core.geometry import exponential, yaw_rotation
from fgrecon.core.point_frames import in_image
from fgrecon.io.kitti_files import Drive, DriveFrame
from fgrecon.perception.from_image import reconstruct_detections
from fgrecon.perception.stereo import stereo_depth
from fgrecon_research.evaluation.point_baselines import score_baselines
from fgrecon_research.evaluation.run import ScoredRivals
from fgrecon_research.io.drive_sensors import Sensor, file_of, lidar_points, right_image

LIDAR, TURNED, STEREO, DEPTH, AFFINE = "lidar", "lidar_turned", "stereo", "depth", "depth_affine"
"""Names of methods."""

THINNED = 4, 16
"""Every so-many-th point is taken, beside all."""

_WRONG_EXTRINSICS = np.radians(0.5)
_SCALES, _SHIFTS = (0.3, 3.0), (-3.0, 3.0)  # of maps in other units: metres for one of theirs, and metres
_LIDAR_SIGMA = 0.05  # metres, of a pixel of a scan


def _evidence(solved: ReconstructedFrame, sensors: Collection[Sensor]) -> dict[str, Evidence]:
    """What each method gets."""
    found: dict[str, Evidence] = {}
    if Sensor.RIGHT in sensors:
        found[STEREO] = stereo_depth(solved.image, solved.camera, right_image(solved.frame))
    if Sensor.DEPTH in sensors:
        found |= _depths(solved)
    if Sensor.LIDAR in sensors:
        place = solved.frame.calibration.camera_T_lidar
        origin = np.zeros(3) if place is None else place[:3, 3]
        scan = Points(lidar_points(solved.frame), origin=origin)
        found |= {LIDAR: scan} | {f"{LIDAR}/{every}": scan.thinned(every) for every in THINNED}
        axis = np.random.default_rng(solved.frame.number).normal(size=3)
        turn = exponential(_WRONG_EXTRINSICS * axis / np.linalg.norm(axis))
        found[TURNED] = Points(scan.points @ turn.T, scan.sigma, origin)
    return found


def _depths(solved: ReconstructedFrame) -> dict[str, DepthMap]:
    """A depth map in metres, and up to scale and shift."""
    height, width = solved.image.shape[:2]
    depth, sigma = np.full((height, width), np.nan), np.full((height, width), _LIDAR_SIGMA)
    if file_of(solved.frame, Sensor.RIGHT) is not None:
        matched = stereo_depth(solved.image, solved.camera, right_image(solved.frame))
        depth, sigma = matched.depth.copy(), np.nan_to_num(np.asarray(matched.sigma), nan=_LIDAR_SIGMA)
    points = lidar_points(solved.frame)
    points = points[in_image(points, solved.camera)]
    points = points[np.argsort(-points[:, 2])]  # what is nearer hides what is behind it
    column, row = np.clip(np.rint(solved.camera.project(points)), 0, [width - 1, height - 1]).astype(int).T
    depth[row, column], sigma[row, column] = points[:, 2], _LIDAR_SIGMA
    chance = np.random.default_rng(solved.frame.number)
    scale, shift = np.exp(chance.uniform(*np.log(_SCALES))), chance.uniform(*_SHIFTS)
    kind = DepthScale.SCALE_AND_SHIFT
    return {
        DEPTH: DepthMap(depth, sigma, relative_sigma=0.0),
        AFFINE: DepthMap((depth - shift) / scale, sigma / scale, relative_sigma=0.0, scale=kind),
    }


def _solved(solved: ReconstructedFrame, evidence: Evidence) -> list[BoxOutcome]:
    setup, labels = solved.setup, solved.frame.objects
    how: dict[str, Any] = {"ground": setup.ground, "size_prior": setup.size_prior, "together": setup.together}
    detections = [vehicle.found.detection for vehicle in solved.vehicles]
    found = reconstruct_detections(
        detections, solved.camera, prior=setup.prior, options=setup.options, evidence=(evidence,), **how
    )
    offset = solved.frame.calibration.label_offset
    return [
        found_outcome(one, solved.truth(vehicle), labels.size[vehicle.label], offset)
        for vehicle, one in zip(solved.vehicles, found, strict=True)
    ]


_EVERY = 2  # rows and columns of a depth map that baselines take


class OtherMethods:
    """Scores on each labelled box of a frame methods that get the keypoints, and methods that get other sensors."""

    def __init__(self, scene: SceneKnowledge, rivals: Sequence[str], sensors: Collection[Sensor]) -> None:
        """Take what is known of the scene.

        Raises:
            InvalidInputError: There is no method of a name.
        """
        self._rivals, self._sensors = ScoredRivals(scene, rivals), sensors

    def __call__(self, solved: ReconstructedFrame) -> list[Mapping[str, BoxOutcome]]:
        """The outcomes of each box by the methods' names."""
        sensed = {name: _solved(solved, evidence) for name, evidence in _evidence(solved, self._sensors).items()}
        scored = [self._rivals(solved), [{n: s[i] for n, s in sensed.items()} for i in range(len(solved.vehicles))]]
        if Sensor.LIDAR in self._sensors:
            scored.append(score_baselines(solved, lidar_points(solved.frame)))
        if Sensor.RIGHT in self._sensors:
            found = stereo_depth(solved.image, solved.camera, right_image(solved.frame))
            points = depth_points(found.depth[::_EVERY, ::_EVERY], solved.camera, _EVERY)
            scored.append(score_baselines(solved, points, "_stereo"))
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
    return np.all(np.abs(local - middle) <= half, axis=1)
