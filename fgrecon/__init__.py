"""Pose and shape of a vehicle from a single image, by factor-graph optimisation on GTSAM.

In three lines:

    import fgrecon
    result = fgrecon.reconstruct(keypoints, intrinsics, confidence=confidence, box=box)
    print(result.status, result.camera_T_object, result.wireframe)

`reconstruct` has the arguments, `Reconstruction` what comes back, `Options` the settings. The factors of the graph are
in the package `factors`.
"""

from fgrecon.camera import Camera, Ground
from fgrecon.catalogue import load_category, load_prior, save_prior
from fgrecon.category import Category
from fgrecon.observation import Observation
from fgrecon.options import BoxModel, Options
from fgrecon.pipeline import reconstruct
from fgrecon.pose.starts import Box3D
from fgrecon.priors.shape_prior import ShapePrior, Surface
from fgrecon.priors.size_prior import SIZE_PRIORS, SizePrior
from fgrecon.reconstruction import Alternative, GraphFactor, Iteration, Reconstruction, Status
from fgrecon.robust import RobustStrategy, StrategyName, strategy
from fgrecon.track import JointStep, TrackReconstruction, reconstruct_track

__all__ = [
    "SIZE_PRIORS",
    "Alternative",
    "Box3D",
    "BoxModel",
    "Camera",
    "Category",
    "GraphFactor",
    "Ground",
    "Iteration",
    "JointStep",
    "Observation",
    "Options",
    "Reconstruction",
    "RobustStrategy",
    "ShapePrior",
    "SizePrior",
    "Status",
    "StrategyName",
    "Surface",
    "TrackReconstruction",
    "load_category",
    "load_prior",
    "reconstruct",
    "reconstruct_track",
    "save_prior",
    "strategy",
]

__docformat__ = "google"  # for the API reference
