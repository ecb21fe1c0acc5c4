"""Evaluation of the networks: against keypoints marked by hand, and end to end on cars of known direction."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.arrays import Array
from fgrecon.core.camera import Camera
from fgrecon.core.coverage import Reliability, reliability
from fgrecon.core.detection import Detection
from fgrecon.core.errors import FgreconError
from fgrecon.core.geometry import view_azimuth
from fgrecon.core.input_warnings import summed_up
from fgrecon.core.metrics import FAILURE_DEGREES, average_precision, orientation_error
from fgrecon.io.images import read_image
from fgrecon.perception.keypoints.detect import REACH, KeypointCascade
from fgrecon_research.training.keypoints.marks import Mark
from fgrecon_research.training.keypoints.posed_cars import PosedCar, Progress, no_progress

GROUPS: dict[str, tuple[str, ...]] = {
    "photographs": ("photographs",),
    "easy": ("easy",),
    "moderate": ("easy", "moderate"),
    "hard": ("easy", "moderate", "hard"),
}
"""Groups of marks; KITTI's regimes are cumulative."""


@dataclass(frozen=True)
class Scored:
    """A marked car, what was found, and how far off that is."""

    mark: Mark  # the car
    detection: Detection  # what the network found
    error: Array  # (K,) distances as fractions of the box's longer side, for visible and hidden keypoints alike


@dataclass(frozen=True)
class Localisation:
    """How well visible keypoints are found in a group of cars."""

    cars: int  # number of cars
    points: int  # number of visible points
    within_tenth: float  # share of them within 0.1 of the box's longer side (PCK)
    within_twentieth: float  # within 0.05
    median: float  # median distance, same unit
    keypoints: Array  # (K, 2) both shares by keypoint, NaN where none is visible
    # (K, 2) average precision by keypoint (APK) at the same distances, likewise: of all cars' points by their
    # confidences, of which hidden ones are wrong
    precisions: Array
    counts: NDArray[np.int64]  # (K,) number of visible points by keypoint


def score_marks(detector: KeypointCascade, marks: Sequence[Mark], progress: Progress = no_progress) -> list[Scored]:
    """Run the network on every marked car; `progress` shows how far it is."""
    scored = []
    images: dict[Any, NDArray[np.uint8]] = {}
    for mark in progress(marks, "Marked cars"):
        if mark.image not in images:
            images = {mark.image: read_image(mark.image)}  # the cars of an image come one after the other
        (detection,) = detector(images[mark.image], [mark.box])
        away = np.linalg.norm(detection.observation.keypoints - mark.keypoints, axis=1) / mark.extent
        scored.append(Scored(mark, detection, away))
    return scored


def localisation(scored: Sequence[Scored], groups: Sequence[str] | None = None, *, least: float = 0.0) -> Localisation:
    """Shares of visible keypoints that are found.

    Args:
        groups: Names of `Mark.group` to count; None for all.
        least: Longer side in pixels from which cars are counted.
    """
    used = [s for s in scored if (groups is None or s.mark.group in groups) and s.mark.extent >= least]
    if not used:
        none = np.zeros((0, 2))
        return Localisation(0, 0, np.nan, np.nan, np.nan, none, none, np.zeros(0, dtype=np.int64))
    error, visible = np.array([s.error for s in used]), np.array([s.mark.visible for s in used])
    near, nearer = (error <= REACH) & visible, (error <= REACH / 2) & visible
    count = visible.sum(axis=0)
    with np.errstate(invalid="ignore"):
        shares = np.stack([near.sum(axis=0) / count, nearer.sum(axis=0) / count], axis=1)
    sure = np.array([s.detection.observation.confidence for s in used])
    precisions = [
        [average_precision(sure[:, k], right[:, k], int(count[k])) for right in (near, nearer)]
        for k in range(len(count))
    ]
    total = max(int(visible.sum()), 1)
    return Localisation(
        cars=len(used),
        points=int(visible.sum()),
        within_tenth=near.sum() / total,
        within_twentieth=nearer.sum() / total,
        median=float(np.median(error[visible])) if visible.any() else float("nan"),
        keypoints=shares,
        precisions=np.array(precisions),
        counts=count,
    )


def marks_reliability(scored: Sequence[Scored], bins: int = 8) -> Reliability:
    """Confidences against marks: right is visible and within 0.1 of the box's longer side."""
    confidence = [s.detection.observation.confidence for s in scored]
    right = [s.mark.visible & (s.error <= REACH) for s in scored]
    return reliability(np.concatenate(confidence), np.concatenate(right), bins)


def adjusted(scored: Sequence[Scored], projections: Sequence[Array | None]) -> list[Scored]:
    """The same cars with the pixels (K, 2) of adjusted wireframes in the place of the network's keypoints.

    As in the paper's Table II; None, where there is no wireframe, is infinitely far.
    """
    after = []
    for item, pixels in zip(scored, projections, strict=True):
        away = np.full(len(item.error), np.inf)
        if pixels is not None:
            away = np.linalg.norm(pixels - item.mark.keypoints, axis=1) / item.mark.extent
        after.append(replace(item, error=away))
    return after


@summed_up()  # what an evaluation solves is measured, not warned of
def azimuth_errors(
    detector: KeypointCascade,
    cars: Sequence[PosedCar],
    solve: Callable[[Detection, Camera], Any],
    progress: Progress = no_progress,
) -> Array:
    """Reconstruct photographs, intrinsics given, and compare the direction from the car to the camera.

    Returns:
        (M,) errors, degrees on the full circle; 180 where a car is refused.
    """
    errors = np.full(len(cars), FAILURE_DEGREES)
    for row, car in progress(list(enumerate(cars)), "Photographs"):
        image = read_image(car.image)
        camera = replace(Camera(car.matrix), image_size=None)  # the photograph's edges are the car's
        (detection,) = detector(image, [car.box])
        try:
            pose = solve(detection, camera).camera_T_object
        except FgreconError:
            continue
        errors[row] = orientation_error([float(view_azimuth(pose[:3, :3], pose[:3, 3]))], [car.azimuth])[0]
    return errors
