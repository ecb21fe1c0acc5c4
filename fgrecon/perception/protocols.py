"""The call signatures that detectors fit, the package's as well as your own, and the check of what they return.

    image ---- VehicleDetector ---- boxes ---- KeypointDetector ---- Detection of each vehicle

Nothing is inherited and nothing registered: whatever can be called like this can be given to `reconstruct_image`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.category import Category
from fgrecon.core.choices import ClassSource
from fgrecon.core.detection import Detection
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.observation import Observation
from fgrecon.core.vehicle_class import VehicleClass
from fgrecon.io.box_results import boxes_from
from fgrecon.io.boxes import NamedBox
from fgrecon.perception.vehicles import Vehicles


@runtime_checkable
class VehicleDetector(Protocol):
    """Finds the vehicles in an image."""

    def __call__(self, image: NDArray[np.uint8], /) -> Vehicles:
        """Boxes (N, 4) and scores (N,) of the vehicles in an image (H, W, 3) of RGB bytes."""


@runtime_checkable
class KeypointDetector(Protocol):
    """Finds the keypoints of vehicles whose boxes are known."""

    @property
    def category(self) -> str:
        """Name of the category whose keypoints it finds, in the order of that category."""

    def __call__(
        self, image: NDArray[np.uint8], boxes: NDArray[np.float64], /
    ) -> Sequence[Observation] | Sequence[Detection]:
        """The keypoints of each vehicle, in the order of the boxes.

        Args:
            image: (H, W, 3) RGB bytes.
            boxes: (N, 4) x1, y1, x2, y2 in pixels.

        Returns:
            N observations, or detections where it also knows from where a vehicle is seen. Let each have its box: the
            solver uses it.
        """


def find_vehicles(detector: VehicleDetector, image: NDArray[np.uint8]) -> Vehicles:
    """What a vehicle detector finds in an image (H, W, 3): `Vehicles`, or an object of `fgrecon.io.box_results`.

    Raises:
        InvalidInputError: It cannot be called, or returns something else.
    """
    if not callable(detector):
        raise InvalidInputError("vehicle_detector", detector, "Give what can be called with an image.")
    found: object = detector(image)
    if isinstance(found, Vehicles):
        return found
    boxes = boxes_from(found)
    if boxes is None:
        fix = "Let it return `fgrecon.perception.Vehicles(boxes, scores)`, or what a known detector or tracker returns."
        raise InvalidInputError("vehicle_detector", f"a returned {type(found).__name__}", fix)
    return _vehicles(boxes)


def _vehicles(boxes: Sequence[NamedBox]) -> Vehicles:
    """Boxes by falling score; one without a score is certain, and beside tracks one without an id is not yet sure."""
    tracked = [box for box in boxes if box.track is not None]
    order = sorted(tracked or boxes, key=lambda box: -1.0 if box.score is None else -box.score)
    corners = np.array([box.corners for box in order]).reshape(-1, 4)
    classes = [box.vehicle_class for box in order]
    return Vehicles(
        corners,
        np.array([1.0 if box.score is None else box.score for box in order]),
        tuple(box.kind or "car" for box in order),
        tuple(one for one in classes if one is not None) if None not in classes else (),
        tuple(box.track for box in order if box.track is not None),
    )


def check_category(detector: object, category: Category) -> None:
    """Refuse a detector of one category beside a shape prior of another."""
    if not isinstance(detector, KeypointDetector):
        fix = "Give what can be called with an image and boxes, and has `category`, the name of its category."
        raise InvalidInputError("keypoint_detector", detector, fix)
    if detector.category != category.name:
        fix = f"The prior's is {category.name}: give a detector and a prior of one category."
        raise InvalidInputError("keypoint_detector.category", detector.category, fix)


def class_by(
    source: ClassSource | None, boxed: VehicleClass | None, kinds: Mapping[str, float] | None
) -> VehicleClass | None:
    """Of which class a vehicle is, by who is to say it; None where nobody is, or does.

    Args:
        source: Who is to say it, or None.
        boxed: What is said with its box.
        kinds: What the keypoint detector says (`Detection.kinds`).
    """
    if source is not ClassSource.KEYPOINTS:
        return None if source is None else boxed
    return None if kinds is None else VehicleClass(kinds)


def find_keypoints(
    detector: KeypointDetector, image: NDArray[np.uint8], boxes: NDArray[np.float64], category: Category
) -> list[Detection]:
    """What a keypoint detector finds in boxes (N, 4) of an image (H, W, 3); for no box it is not asked.

    Raises:
        InvalidInputError: It is none, is of another category, or returns something else than a detection for each box.
    """
    check_category(detector, category)
    if not len(boxes):
        return []
    found: Any = detector(image, boxes)
    fix = f"Let it return an `fgrecon.Observation` or `fgrecon.Detection` for each of the {len(boxes)} boxes."
    if not isinstance(found, Sequence):
        raise InvalidInputError("keypoint_detector", f"a returned {type(found).__name__}", fix)
    if len(found) != len(boxes):
        raise InvalidInputError("keypoint_detector", f"{len(found)} returned detections", fix)
    return [_detection(number, item, category, fix) for number, item in enumerate(found)]


def _detection(number: int, found: Any, category: Category, fix: str) -> Detection:
    field = f"keypoint_detector: detection[{number}]"
    detection = Detection(found) if isinstance(found, Observation) else found
    if not isinstance(detection, Detection):
        raise InvalidInputError(field, f"a returned {type(found).__name__}", fix)
    count = len(detection.observation.keypoints)
    if count != category.size:
        raise InvalidInputError(field, f"{count} keypoints", f"Category {category.name} has {category.size}.")
    return detection
