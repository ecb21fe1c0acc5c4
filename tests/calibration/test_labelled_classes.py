"""Of which class labelled boxes are where labels are scored with classes: by labels, or by the detector's boxes."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from fgrecon import VehicleClass, Vehicles
from fgrecon.calibration import labelled_frames
from fgrecon.core.choices import ClassSource

BOXES = np.array([[100.0, 100, 200, 160], [300, 100, 360, 140], [500, 100, 520, 120]])
IMAGE = np.zeros((375, 1242, 3), np.uint8)
FRAME: Any = SimpleNamespace(objects=SimpleNamespace(kind=["Car", "Van", "Truck", "Car"]))


def looked(source: ClassSource | None, **more: Any) -> list[tuple[str, str] | None] | None:
    """Scheme and name of each box's class."""
    setup: Any = SimpleNamespace(**({"classes": source, "vehicles": None, "classifier": None} | more))
    found = labelled_frames._classes(FRAME, IMAGE, [1, 2, None], BOXES, [VehicleClass("bus")] * 3, setup)
    if found is None:
        return None
    return [None if one is None else (one.scheme.value, *one.probabilities) for one in found]


def test_labels_say_the_class_of_the_box_that_is_theirs() -> None:
    assert looked(None) is None
    assert looked(ClassSource.LABELS) == [("kitti", "Van"), ("kitti", "Truck"), None]


def test_the_detector_says_it_of_its_own_boxes() -> None:
    assert looked(ClassSource.DETECTED, vehicles=object()) == [("fgrecon", "bus")] * 3
    assert looked(ClassSource.DETECTED) == [("fgrecon", "bus")] * 3


@pytest.mark.parametrize("moved", [2.0, 80.0])
def test_of_labelled_boxes_the_detected_one_that_overlaps_says_it(moved: float) -> None:
    def classifier(image: np.ndarray) -> Vehicles:
        boxes = np.array([BOXES[1], BOXES[0] + moved])
        return Vehicles(boxes, np.ones(2), classes=(VehicleClass("truck", "coco"), VehicleClass("car", "coco")))

    first = ("coco", "car") if moved < 50.0 else None
    assert looked(ClassSource.DETECTED, classifier=classifier) == [first, ("coco", "truck"), None]
