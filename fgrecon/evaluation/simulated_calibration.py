"""What results say of themselves on simulated vehicles, whose shape is known to the last keypoint."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.camera import Ground
from fgrecon.core.coverage import Region
from fgrecon.core.errors import FgreconError
from fgrecon.core.options import Options
from fgrecon.core.reconstruction import Reconstruction
from fgrecon.core.shape_prior import ShapePrior
from fgrecon.core.size_prior import SizePrior
from fgrecon.evaluation.calibration import Judged, judged
from fgrecon.evaluation.consistency import normalised_squared_error
from fgrecon.evaluation.video_images import outcome
from fgrecon.io.track_file import GroundTruth
from fgrecon.simulation.keypoint_noise import HOURGLASS, NoiseModel
from fgrecon.simulation.vehicles import KITTI_CAMERA, Vehicle, simulate_many
from fgrecon.solve.pipeline import reconstruct
from fgrecon.solve.vehicle.model import prepare

__all__ = ["judge_simulated", "keypoint_regions"]

_GROUPS = 10  # that are left out of their own baselines in turn


def judge_simulated(
    count: int,
    prior: ShapePrior,
    *,
    ground: Ground | None = None,
    size_prior: SizePrior | None = None,
    options: Options | None = None,
    noise: NoiseModel = HOURGLASS,
    seed: int = 0,
) -> Iterator[Judged | None]:
    """Reconstruct simulated vehicles one by one, and judge what each result says of itself; None where one is refused.

    Args:
        count: How many.
        prior: Shape prior, from which shapes are drawn as well, as the fleet has them.
        ground: The ground that is told, or None.
        size_prior: The fleet that is told, or None.
        options: Settings.
        noise: The keypoint network's mistakes.
        seed: Of everything random.
    """
    nowhere, model, rng = np.zeros(3), prepare(prior, size_prior, None), np.random.default_rng(seed)
    for number in range(count):
        shape = rng.multivariate_normal(np.zeros(prior.dimension), model.fleet_spread, method="cholesky")
        ((seen, truth),) = simulate_many([Vehicle.of_prior(model.prior, shape)], 1, rng, noise)
        try:
            found = reconstruct(seen, KITTI_CAMERA, prior=prior, ground=ground, size_prior=size_prior, options=options)
        except FgreconError:
            yield None
            continue
        pose, group = truth.camera_T_object, str(number % _GROUPS)
        yaw = float(np.arctan2(-pose[2, 0], pose[0, 0]))
        size = model.prior.box_size(shape)
        off = outcome(found, GroundTruth(pose[:3, 3], yaw), size, nowhere)
        one = judged(off, group, float(np.linalg.norm(pose[:3, 3])), found.status.value)
        extra = () if one.turned else keypoint_regions(found, truth.vehicle.keypoints, group)
        yield Judged(one.status, one.turned, one.wrong, one.facing, (*one.regions, *extra))


def keypoint_regions(result: Reconstruction, keypoints: NDArray[np.float64], group: str) -> tuple[Region, ...]:
    """The errors of 3D keypoints (K, 3) in the object's frame, by the result's covariances; NaN rows are not known."""
    if result.keypoint_covariance is None:
        return ()
    found = []
    for error, covariance in zip(result.wireframe - keypoints, result.keypoint_covariance, strict=True):
        squared = normalised_squared_error(error, covariance) if np.isfinite(error).all() else None
        if squared is not None:
            radius = float(np.linalg.det(covariance)) ** (1.0 / 6.0)
            found.append(Region(group, "keypoints", squared, 3, radius, float(np.linalg.norm(error))))
    return tuple(found)
