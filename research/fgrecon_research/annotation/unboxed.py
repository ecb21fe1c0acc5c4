"""Keypoints of vehicles with 2D boxes and tracks alone: their own reconstruction stands for the 3D box.

Nothing outvotes the network here but the other images of a vehicle, its neighbours and what is known of the scene: all
images go through `fgrecon.Tracker`, whose smoothing decides which way each vehicle faces, and only images that it is
sure of are kept. A vehicle that the network sees with a heading flip in most of its images keeps that.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from factors.projection import by_pose
from fgrecon.calibration.labelled_boxes import Reason
from fgrecon.core.arrays import Array
from fgrecon.core.camera import Camera, Ground
from fgrecon.core.errors import DegenerateProblemError
from fgrecon.core.geometry import pixel_jacobian, transform
from fgrecon.core.observation import Observation
from fgrecon.core.reconstruction import Reconstruction
from fgrecon.core.shape_prior import ShapePrior
from fgrecon.core.size_prior import SizePrior
from fgrecon.io.kitti_files import IMAGES_PER_SECOND
from fgrecon.solve.tracker import Tracker
from fgrecon.solve.vehicle.model import prepare
from fgrecon_research.annotation.annotation import Fit

_SURE = 0.99  # least probability of the way that a vehicle faces, by all of its images

Frames = Mapping[int, tuple[Camera, Mapping[int, Observation]]]
"""By the number of a frame: the camera, and the vehicles that it shows by their tracks."""


@dataclass(frozen=True)
class Unboxed:
    """What is known where there are no 3D boxes."""

    ground: Ground | None = None  # ground plane in every camera's frame, or None
    size: SizePrior | None = None  # size of the fleet; None for the shape prior's


def fit_unboxed(
    frames: Frames,
    prior: ShapePrior,
    known: Unboxed,
    progress: Callable[[Sequence[Any], str], Iterable[Any]] = lambda things, _: things,
) -> dict[tuple[int, int], Fit | Reason]:
    """The poses and shapes of vehicles of unknown boxes.

    Args:
        frames: Their keypoints, with the 2D boxes, ten images a second.

    Returns:
        A fit for each frame and track, or why there is none. Covariances take pose and shape for independent, which
        they are not: they are rather too large than too small.

    Raises:
        InvalidInputError: An observation is of another category.
    """
    tracker = Tracker(prior=prior, size_prior=known.size, past=None)
    found: dict[tuple[int, int], Fit | Reason] = {}
    for number in progress(sorted(frames), "Tracks"):
        camera, vehicles = frames[number]
        tracker.update(number / IMAGES_PER_SECOND, vehicles, camera=camera, ground=known.ground)
        for track, error in tracker.refused.items():
            if not isinstance(error, DegenerateProblemError):
                raise error
            found[number, track] = Reason.FEW_POINTS
    model = prepare(prior, known.size)
    for track, estimates in tracker.smooth().items():
        numbers = [number for number in sorted(frames) if track in frames[number][1] and (number, track) not in found]
        for number, estimate in zip(numbers, estimates, strict=True):
            result = estimate.reconstruction
            if (
                not result.status.settled
                or result.uncertainty.pose_covariance is None
                or estimate.facing_probability < _SURE
            ):
                found[number, track] = Reason.UNSURE
            else:
                found[number, track] = Fit.of(result, _covariances(result, frames[number][0]), model.prior)
    return found


def _covariances(result: Reconstruction, camera: Camera) -> Array:
    """(K, 2, 2) of the projected keypoints, square pixels, with pose and shape taken for independent."""
    pose = result.camera_T_object
    by_camera = pixel_jacobian(camera.matrix, transform(pose, result.wireframe))
    by_turn, by_point = by_pose(result.wireframe, pose[:3, :3], by_camera)
    by_all = np.concatenate([by_turn, by_point], axis=-1)
    assert result.uncertainty.pose_covariance is not None
    assert result.uncertainty.keypoint_covariance is not None  # both are there or none
    covariance: Array = by_all @ result.uncertainty.pose_covariance @ by_all.transpose(0, 2, 1)
    return covariance + by_point @ result.uncertainty.keypoint_covariance @ by_point.transpose(0, 2, 1)
