"""What results say of themselves on simulated vehicles, whose shape is known to the last keypoint."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from fgrecon.calibration.labelled_boxes import outcome
from fgrecon.calibration.regions import normalised_squared_error
from fgrecon.core.camera import Ground
from fgrecon.core.coverage import Region
from fgrecon.core.errors import FgreconError
from fgrecon.core.options import Options
from fgrecon.core.reconstruction import Reconstruction
from fgrecon.core.shape_prior import ShapePrior
from fgrecon.core.size_prior import SizePrior
from fgrecon.io.track_file import GroundTruth
from fgrecon.simulation.keypoint_noise import HOURGLASS, NoiseModel
from fgrecon.simulation.vehicles import KITTI_CAMERA, Vehicle
from fgrecon.solve.pipeline import reconstruct
from fgrecon.solve.vehicle.model import prepare
from fgrecon_research.evaluation.calibration import Judged, judged
from fgrecon_research.simulation import simulate_many

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
        prior: Shape prior, from which shapes are drawn as well, as the fleet has them; of any fleet where none is told.
        ground: The ground that is told, or None.
        size_prior: The fleet that is told, or None.
        options: Settings.
        noise: The keypoint network's mistakes.
        seed: Of everything random.
    """
    model, rng = prepare(prior, size_prior, None), np.random.default_rng(seed)
    spread = model.any_fleet_spread if size_prior is None else model.spread_of(np.diag(size_prior.sigma**2))
    for number in range(count):
        shape = rng.multivariate_normal(np.zeros(prior.dimension), spread, method="cholesky")
        ((seen, truth),) = simulate_many([Vehicle.of_prior(model.prior, shape)], 1, rng, noise)
        try:
            found = reconstruct(seen, KITTI_CAMERA, prior=prior, ground=ground, size_prior=size_prior, options=options)
        except FgreconError:
            yield None
            continue
        size = model.prior.box_size(shape)
        yield judge_known(found, truth.camera_T_object, size, truth.vehicle.keypoints, str(number % _GROUPS))


def judge_known(
    result: Reconstruction,
    camera_T_object: NDArray[np.float64],
    size: NDArray[np.float64],
    keypoints: NDArray[np.float64],
    group: str,
) -> Judged:
    """What a result says of itself, beside pose and shape that are known.

    Args:
        result: The result.
        camera_T_object: (4, 4) true pose.
        size: (3,) true length, width and height, metres.
        keypoints: (K, 3) true keypoints in the object's frame; NaN rows are not known.
        group: What its regions are left out of the baselines with.
    """
    place = camera_T_object[:3, 3]
    yaw = float(np.arctan2(-camera_T_object[2, 0], camera_T_object[0, 0]))
    off = outcome(result, GroundTruth(place, yaw), size, np.zeros(3))
    one = judged(off, group, float(np.linalg.norm(place)), result.status.value)
    extra = () if one.flipped else keypoint_regions(result, keypoints, group)
    return Judged(one.status, one.flipped, one.wrong, one.facing, (*one.regions, *extra))


def keypoint_regions(result: Reconstruction, keypoints: NDArray[np.float64], group: str) -> tuple[Region, ...]:
    """The errors of 3D keypoints (K, 3) in the object's frame, by the result's covariances; NaN rows are not known."""
    if result.uncertainty.keypoint_covariance is None:
        return ()
    found = []
    for error, covariance in zip(result.wireframe - keypoints, result.uncertainty.keypoint_covariance, strict=True):
        squared = normalised_squared_error(error, covariance) if np.isfinite(error).all() else None
        if squared is not None:
            radius = float(np.linalg.det(covariance)) ** (1.0 / 6.0)
            found.append(Region(group, "keypoints", squared, 3, radius, float(np.linalg.norm(error))))
    return tuple(found)
