"""From photographs to keypoints and cars.

`reconstruct_image` does all of it. `VehicleDetector` and `KeypointDetector` say what a detector of your own is called
with and what it returns: a `Vehicles`, and an `fgrecon.Observation` or a `Detection` for each box. The package's are
`NanodetVehicleDetector` and `KeypointCascade`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from factors.lazy import lazy_names

if TYPE_CHECKING:  # imported when used
    from fgrecon.core.detection import Detection
    from fgrecon.perception.boxes import find_boxes
    from fgrecon.perception.from_image import FromImage, reconstruct_detection, reconstruct_image
    from fgrecon.perception.keypoints.detect import CascadeDetection, KeypointCascade, detect_keypoints
    from fgrecon.perception.protocols import KeypointDetector, VehicleDetector
    from fgrecon.perception.vehicles import NanodetVehicleDetector, Vehicles

__all__ = [
    "CascadeDetection",
    "Detection",
    "FromImage",
    "KeypointCascade",
    "KeypointDetector",
    "NanodetVehicleDetector",
    "VehicleDetector",
    "Vehicles",
    "detect_keypoints",
    "find_boxes",
    "reconstruct_detection",
    "reconstruct_image",
]

__getattr__, __dir__ = lazy_names(__name__)
