"""Pose and shape of a vehicle from a single image, by factor-graph optimisation on GTSAM.

From a photograph, and from keypoints:

    import fgrecon
    for vehicle in fgrecon.reconstruct_image("street.jpg", camera=(721.5, 721.5, 609.6, 172.9)):
        print(vehicle.result)
    result = fgrecon.reconstruct(keypoints, intrinsics, confidence=confidence, box=box)
    print(result.status, result.camera_T_object, result.wireframe)

`reconstruct_image` takes networks of your own for boxes and keypoints (`VehicleDetector`, `KeypointDetector`),
`reconstruct` keypoints of any origin; `keypoints_from` takes what other networks return. `Reconstruction` is what comes
back, `Options` the settings, `fgrecon.errors` has the errors. The factors of the graph are in the package `factors`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from factors.lazy import lazy_names

if TYPE_CHECKING:  # imported when used
    from fgrecon import errors as errors
    from fgrecon._version import __version__
    from fgrecon.core.box3d import Box3D, BoxErrors
    from fgrecon.core.camera import Camera, Ground
    from fgrecon.core.category import Category, MotionModel
    from fgrecon.core.choices import BoxModel, DepthScale, StrategyName
    from fgrecon.core.depth_map import DepthCalibration, DepthMap
    from fgrecon.core.detection import Detection
    from fgrecon.core.detector_calibration import DetectorCalibration
    from fgrecon.core.evidence import Points, Range, RangeRate, StereoPair, VehicleClass
    from fgrecon.core.mask import Mask
    from fgrecon.core.observation import Observation
    from fgrecon.core.options import BoxOptions, KeypointOptions, Options, SearchOptions, ShapeOptions
    from fgrecon.core.reconstruction import Alternative, GraphFactor, Iteration, Reconstruction, Status, rotation_y
    from fgrecon.core.refined_box import RefinedBox
    from fgrecon.core.result_fields import Regions
    from fgrecon.core.robust import RobustStrategy, strategy
    from fgrecon.core.scene_reconstruction import SceneReconstruction
    from fgrecon.core.shape_prior import ShapePrior, Surface
    from fgrecon.core.size_prior import SIZE_PRIORS, SizePrior
    from fgrecon.core.track_reconstruction import JointStep, TrackReconstruction
    from fgrecon.core.vehicle_estimate import VehicleEstimate
    from fgrecon.io.catalogue import load_calibration, load_category, load_prior, save_calibration, save_prior
    from fgrecon.io.images import read_image
    from fgrecon.io.keypoints.any_keypoints import keypoints_from
    from fgrecon.perception.from_image import FromImage, reconstruct_image
    from fgrecon.perception.protocols import KeypointDetector, VehicleDetector
    from fgrecon.perception.refine import refine_boxes
    from fgrecon.perception.vehicles import Vehicles
    from fgrecon.solve.pipeline import reconstruct
    from fgrecon.solve.scene import reconstruct_scene, reconstruct_scenes
    from fgrecon.solve.track import reconstruct_track
    from fgrecon.solve.tracker import Tracker

__all__ = [
    "SIZE_PRIORS",
    "Alternative",
    "Box3D",
    "BoxErrors",
    "BoxModel",
    "BoxOptions",
    "Camera",
    "Category",
    "DepthCalibration",
    "DepthMap",
    "DepthScale",
    "Detection",
    "DetectorCalibration",
    "FromImage",
    "GraphFactor",
    "Ground",
    "Iteration",
    "JointStep",
    "KeypointDetector",
    "KeypointOptions",
    "Mask",
    "MotionModel",
    "Observation",
    "Options",
    "Points",
    "Range",
    "RangeRate",
    "Reconstruction",
    "RefinedBox",
    "Regions",
    "RobustStrategy",
    "SceneReconstruction",
    "SearchOptions",
    "ShapeOptions",
    "ShapePrior",
    "SizePrior",
    "Status",
    "StereoPair",
    "StrategyName",
    "Surface",
    "TrackReconstruction",
    "Tracker",
    "VehicleClass",
    "VehicleDetector",
    "VehicleEstimate",
    "Vehicles",
    "__version__",
    "keypoints_from",
    "load_calibration",
    "load_category",
    "load_prior",
    "read_image",
    "reconstruct",
    "reconstruct_image",
    "reconstruct_scene",
    "reconstruct_scenes",
    "reconstruct_track",
    "refine_boxes",
    "rotation_y",
    "save_calibration",
    "save_prior",
    "strategy",
]

__docformat__ = "google"  # for the API reference

__getattr__, __dir__ = lazy_names(__name__)
