"""Pose and shape of a vehicle from a single image, by factor-graph optimisation on GTSAM.

In three lines:

    import fgrecon
    result = fgrecon.reconstruct(keypoints, intrinsics, confidence=confidence, box=box)
    print(result.status, result.camera_T_object, result.wireframe)

`reconstruct` has the arguments, `Reconstruction` what comes back, `Options` the settings. The factors of the graph are
in the package `factors`.
"""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

from factors.lazy import lazy_names
from fgrecon._moved import MovedFinder

if TYPE_CHECKING:  # imported when used
    from fgrecon.core.box3d import Box3D
    from fgrecon.core.camera import Camera, Ground
    from fgrecon.core.category import Category
    from fgrecon.core.observation import Observation
    from fgrecon.core.options import BoxModel, Options
    from fgrecon.core.reconstruction import Alternative, GraphFactor, Iteration, Reconstruction, Status
    from fgrecon.core.robust import RobustStrategy, StrategyName, strategy
    from fgrecon.core.shape_prior import ShapePrior, Surface
    from fgrecon.core.size_prior import SIZE_PRIORS, SizePrior
    from fgrecon.io.catalogue import load_category, load_prior, save_prior
    from fgrecon.io.images import read_image
    from fgrecon.perception.from_image import FromImage, reconstruct_image
    from fgrecon.solve.pipeline import reconstruct
    from fgrecon.solve.track import JointStep, TrackReconstruction, reconstruct_track

__all__ = [
    "SIZE_PRIORS",
    "Alternative",
    "Box3D",
    "BoxModel",
    "Camera",
    "Category",
    "FromImage",
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
    "read_image",
    "reconstruct",
    "reconstruct_image",
    "reconstruct_track",
    "save_prior",
    "strategy",
]

__docformat__ = "google"  # for the API reference

sys.meta_path.insert(0, MovedFinder())

__getattr__, __dir__ = lazy_names(__name__)
