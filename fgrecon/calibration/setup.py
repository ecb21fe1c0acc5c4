"""Scene knowledge with which labelled vehicles are reconstructed, and the settings of the fits to them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from fgrecon.calibration.labelled_boxes import MINIMUM_OVERLAP
from fgrecon.core.arrays import Array
from fgrecon.core.camera import Camera, Ground
from fgrecon.core.choices import ClassSource
from fgrecon.core.options import Options
from fgrecon.core.shape_prior import ShapePrior
from fgrecon.core.size_prior import SizePrior
from fgrecon.core.vehicle_class import VehicleClass
from fgrecon.perception.from_image import FromImage, reconstruct_image
from fgrecon.perception.keypoints.detect import KeypointCascade
from fgrecon.perception.protocols import VehicleDetector


@dataclass(frozen=True)
class CalibrationSettings:
    """What a detector is fitted by, and when a fit is warned of. Where nothing else is said, not tuned."""

    common_factors: tuple[float, ...] = (1.0, 2.0, 4.0, 8.0, 16.0, 32.0)  # that are tried
    fewest_vehicles: int = 30  # that regions, or the edges of boxes, are judged by
    fewest_flipped: int = 5  # vehicles, without which nothing tells what a direction counts
    facing_bounds: tuple[tuple[float, float], ...] = ((-10.0, 10.0), (0.0, 10.0))  # of `facing_bias` and `facing_slope`
    tolerated_shortfall: float = 0.1
    """Share that regions hold less than they claim at most; those of the shipped networks are short by 0.09."""
    matching_overlap: float = 0.5  # intersection over union from which on a detected box is a labelled one's


SETTINGS = CalibrationSettings()


@dataclass(frozen=True)
class SceneKnowledge:
    """What the user knows; each method is given the part that its name says."""

    prior: ShapePrior  # shape prior of the category
    ground: Ground  # ground plane in the camera's frame
    size: SizePrior  # size of the fleet


@dataclass(frozen=True)
class Setup:
    """What every car is reconstructed with."""

    detector: KeypointCascade  # finds the keypoints
    prior: ShapePrior
    ground: Ground | None  # ground plane, or None
    size_prior: SizePrior | None  # fleet, or None
    options: Options  # settings
    overlap: float = MINIMUM_OVERLAP["Car"]  # from which overlap on a detected box is a labelled car's
    together: bool = True  # whether the vehicles of an image share one ground (`fgrecon.reconstruct_scene`)
    # finds the vehicles in frames of drives; None where the labelled boxes are the input
    vehicles: VehicleDetector | None = None
    classes: ClassSource | None = None  # who says of which class they are, or None
    # the vehicle detector that says so of labelled boxes, where a detector does
    classifier: VehicleDetector | None = None


def reconstruct_boxes(
    image: NDArray[np.uint8],
    camera: Camera,
    boxes: Sequence[Array],
    setup: Setup,
    classes: Sequence[VehicleClass | None] | Literal["keypoints"] | None = None,
) -> list[FromImage]:
    """What is found in the boxes (4,) of an image, by their classes; their parts outside the image are cut off."""
    limits = np.array([image.shape[1], image.shape[0]] * 2) - 1.0
    return reconstruct_image(
        image,
        camera,
        np.clip(np.reshape(boxes, (-1, 4)), 0.0, limits),
        keypoint_detector=setup.detector,
        prior=setup.prior,
        ground=setup.ground,
        size_prior=setup.size_prior,
        options=setup.options,
        together=setup.together,
        classes=classes,
    )
