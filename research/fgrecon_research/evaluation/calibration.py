"""Calibration of results' uncertainty by scored boxes: regions, facing, status."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgrecon.calibration.labelled_boxes import (
    FLIPPED_DEGREES,
    BoxOutcome,
    VideoBox,
    claimed_regions,
    normalised_squared_error,
    outcome,
)
from fgrecon.core.camera import Ground
from fgrecon.core.coverage import LEVELS, Coverage, Region, Reliability, coverage, reliability
from fgrecon.core.errors import FgreconError
from fgrecon.core.reconstruction import Reconstruction, Status
from fgrecon.core.serialise import finite
from fgrecon.core.shape_prior import ShapePrior
from fgrecon.core.size_prior import SizePrior
from fgrecon.io.track_file import GroundTruth
from fgrecon.simulation.vehicles import KITTI_CAMERA, Vehicle
from fgrecon.solve.pipeline import reconstruct
from fgrecon.solve.vehicle.model import prepare
from fgrecon_research.simulation import simulate_many

FORMAT = "fgrecon.calibration/1"
WRONG = (15.0, 0.2)
"""A result is wrong beyond so many degrees of yaw, or parts of the distance."""

_LEAST = (0.9, 0.95, 0.99)


@dataclass(frozen=True)
class StatusCount:
    """Results of one status."""

    status: str
    count: int  # number of results
    flipped: int  # of these flipped, by more than 90 degrees
    wrong: int  # of these wrong (`WRONG`), turned ones included


@dataclass(frozen=True)
class Acceptance:
    """Who takes only results that are settled and whose facing has at least some probability, and what that costs."""

    least: float  # that probability
    flipped: int  # number of results that are flipped
    flipped_refused: int  # of these refused
    right: int  # number of the other results
    right_refused: int  # of these refused
    sure: int  # number of results that are `converged` and not refused
    sure_flipped: int  # of these flipped


@dataclass(frozen=True)
class Calibration:
    """What results of one method say, beside what is so."""

    # of each quantity; vehicles flipped are left out, which the facing's probability is about
    regions: tuple[Coverage, ...]
    facing: Reliability  # of the facing's probability; without a bin where there is none
    statuses: tuple[StatusCount, ...]  # by their names
    acceptance: tuple[Acceptance, ...] = ()  # by the least probability of the facing


@dataclass(frozen=True)
class Judged:
    """What one result says of itself, beside the truth."""

    status: str
    flipped: bool  # whether it is flipped
    wrong: bool  # whether it is wrong (`WRONG`)
    facing: float | None  # its facing's probability, or None
    regions: tuple[Region, ...]  # its errors by the regions that it claims


def judged(found: BoxOutcome, group: str, distance: float, status: str) -> Judged:
    """A result of some status beside the truth, of a vehicle at a distance in metres from the camera."""
    flipped = found.degrees > FLIPPED_DEGREES
    off = found.degrees > WRONG[0] or found.metres > WRONG[1] * distance
    return Judged(status, flipped, off, found.facing, claimed_regions(found, group))


def calibrate_boxes(boxes: Sequence[VideoBox], method: str) -> Calibration:
    """Compare what a method says of its results with the labels; drives are left out of their own baselines."""
    found = [(box, box.outcomes[method]) for box in boxes]
    return calibrate([judged(one, box.drive, box.distance, one.status) for box, one in found if one.status is not None])


def calibrate(results: Sequence[Judged]) -> Calibration:
    """Compare what results say of themselves with the truth; groups are left out of their own baselines."""
    regions = [region for one in results for region in one.regions]
    faced = [(one.facing, not one.flipped) for one in results if one.facing is not None]
    counts: dict[str, list[Judged]] = {}
    for one in results:
        counts.setdefault(one.status, []).append(one)
    statuses = [
        StatusCount(status, len(some), sum(one.flipped for one in some), sum(one.wrong for one in some))
        for status, some in sorted(counts.items())
    ]
    facing = reliability([sure for sure, _ in faced], [right for _, right in faced])
    acceptance = tuple(_acceptance(results, least) for least in _LEAST)
    return Calibration(tuple(coverage(regions)), facing, tuple(statuses), acceptance)


def _acceptance(results: Sequence[Judged], least: float) -> Acceptance:
    refused = [not Status(one.status).settled or (one.facing is not None and one.facing < least) for one in results]
    flipped = [no for one, no in zip(results, refused, strict=True) if one.flipped]
    right = [no for one, no in zip(results, refused, strict=True) if not one.flipped]
    pairs = zip(results, refused, strict=True)
    sure = [one.flipped for one, no in pairs if not no and one.status == Status.CONVERGED.value]
    return Acceptance(least, len(flipped), sum(flipped), len(right), sum(right), len(sure), sum(sure))


def calibration_document(found: Calibration, given: dict[str, Any]) -> dict[str, Any]:
    """Plain values for JSON; what is not known is None."""
    return {
        "format": FORMAT,
        **given,
        "regions": [
            {
                "quantity": one.quantity,
                "count": one.count,
                "levels": LEVELS.tolist(),
                "claimed": one.claimed.tolist(),
                "inside": {f"{level:g}": finite(some) for level, some in one.inside.items()},
                "width": {f"{level:g}": finite(some) for level, some in one.width.items()},
            }
            for one in found.regions
        ],
        "facing": {
            "error": found.facing.error,
            "confidence": found.facing.confidence.tolist(),
            "right": found.facing.right.tolist(),
            "count": found.facing.count.tolist(),
        },
        "statuses": [asdict(one) for one in found.statuses],
        "acceptance": [asdict(one) for one in found.acceptance],
    }


# What results say of themselves on simulated vehicles, whose shape is known to the last keypoint.

_GROUPS = 10  # that are left out of their own baselines in turn


def judge_simulated(
    count: int,
    prior: ShapePrior,
    *,
    ground: Ground | None = None,
    size_prior: SizePrior | None = None,
) -> Iterator[Judged | None]:
    """Reconstruct simulated vehicles one by one, and judge what each result says of itself; None where one is refused.

    Args:
        prior: Shape prior, from which shapes are drawn as well, as the fleet has them; of any where none is given.
        ground: The ground that is given, or None.
        size_prior: The fleet that is given, or None.
    """
    model, rng = prepare(prior, size_prior, None), np.random.default_rng(0)
    spread = model.any_fleet_spread if size_prior is None else model.spread_of(np.diag(size_prior.sigma**2))
    for number in range(count):
        shape = rng.multivariate_normal(np.zeros(prior.dimension), spread, method="cholesky")
        ((observation, truth),) = simulate_many([Vehicle.of_prior(model.prior, shape)], 1, rng)
        try:
            found = reconstruct(observation, KITTI_CAMERA, prior=prior, ground=ground, size_prior=size_prior)
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
        camera_T_object: (4, 4) true pose.
        size: (3,) true length, width and height, metres.
        keypoints: (K, 3) true keypoints in the object's frame; NaN rows are not known.
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
