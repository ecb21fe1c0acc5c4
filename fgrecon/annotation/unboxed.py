"""The keypoints of a vehicle of which only 2D boxes and its track are known: its own reconstruction stands for the box.

Nothing outvotes the network here but the other images and what is known of the scene, so only images that a
reconstruction of the whole track is sure of are kept.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from factors.projection import by_pose
from fgrecon.annotation.fit import Fit
from fgrecon.annotation.wanted import Reason
from fgrecon.core.camera import Camera, Ground
from fgrecon.core.errors import DegenerateProblemError
from fgrecon.core.geometry import pixel_jacobian, transform
from fgrecon.core.observation import Observation
from fgrecon.core.options import Options
from fgrecon.core.reconstruction import Reconstruction
from fgrecon.core.shape_prior import ShapePrior
from fgrecon.core.size_prior import SizePrior
from fgrecon.solve.track import reconstruct_track
from fgrecon.solve.vehicle.model import prepare

__all__ = ["Unboxed", "fit_unboxed"]

Array = NDArray[np.float64]

_NEIGHBOURS = 5  # images before and after that tell which way a vehicle faces


@dataclass(frozen=True)
class Unboxed:
    """What is known where there are no 3D boxes.

    Attributes:
        ground: Ground plane in every camera's frame, or None.
        size: Size of the fleet; None for the shape prior's.
    """

    ground: Ground | None = None
    size: SizePrior | None = None


def fit_unboxed(views: Sequence[tuple[Observation, Camera]], prior: ShapePrior, known: Unboxed) -> list[Fit | Reason]:
    """The poses and the shape of a vehicle of unknown boxes.

    Args:
        views: Its keypoints, with the 2D box, and the camera in each image, in the order of time.
        prior: Shape prior.
        known: What is known beside.

    Returns:
        A fit for each image, or why there is none. Covariances take pose and shape for independent, which they are not:
        they are rather too large than too small.

    Raises:
        InvalidInputError: An observation is of another category.
    """
    observations, cameras = [seen for seen, _ in views], [camera for _, camera in views]
    try:
        track = reconstruct_track(
            *(observations, cameras),
            prior=prior,
            ground=known.ground,
            size_prior=known.size,
            options=Options(keep_history=False),
        )
    except DegenerateProblemError:
        return [Reason.FEW_POINTS] * len(views)
    model = prepare(prior, known.size)
    turned = _turned([result.camera_T_object for result in track.frames])
    found: list[Fit | Reason] = [Reason.FEW_POINTS] * len(views)
    for number, result, wrong in zip(track.numbers, track.frames, turned, strict=True):
        if not result.status.settled or result.pose_covariance is None:
            found[number] = Reason.UNSURE
        elif wrong:
            found[number] = Reason.TURNED
        else:
            found[number] = Fit.of(result, _covariances(result, cameras[number]), model.prior)
    return found


def _turned(poses: Sequence[Array]) -> list[bool]:
    """Whether most of the images around each show the vehicle facing the other way."""
    forward = np.array([pose[:3, 0] for pose in poses])
    votes = forward @ forward.T
    apart = np.abs(np.subtract.outer(np.arange(len(poses)), np.arange(len(poses))))
    return [bool(total < 0.0) for total in np.where((apart > 0) & (apart <= _NEIGHBOURS), votes, 0.0).sum(axis=1)]


def _covariances(result: Reconstruction, camera: Camera) -> Array:
    """(K, 2, 2) of the projected keypoints, square pixels, with pose and shape taken for independent."""
    pose = result.camera_T_object
    by_camera = pixel_jacobian(camera.matrix, transform(pose, result.wireframe))
    by_turn, by_point = by_pose(result.wireframe, pose[:3, :3], by_camera)
    by_all = np.concatenate([by_turn, by_point], axis=-1)
    assert result.pose_covariance is not None
    assert result.keypoint_covariance is not None  # both are there or none
    covariance: Array = by_all @ result.pose_covariance @ by_all.transpose(0, 2, 1)
    return covariance + by_point @ result.keypoint_covariance @ by_point.transpose(0, 2, 1)
