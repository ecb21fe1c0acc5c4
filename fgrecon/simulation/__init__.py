"""Vehicles, keypoints and images that the project makes itself, with known truth."""

from __future__ import annotations

from typing import TYPE_CHECKING

from factors.lazy import lazy_names

if TYPE_CHECKING:  # imported when used
    from fgrecon.simulation.keypoint_noise import HOURGLASS, NoiseModel
    from fgrecon.simulation.sample import DemoScene, SampleStreet, demo_scene, sample_drive, sample_scan, sample_street
    from fgrecon.simulation.vehicles import (
        KITTI_CAMERA,
        SimulatedTruth,
        Vehicle,
        kitti_like_pose,
        simulate,
        simulate_track,
        yaw_pose,
    )

__all__ = [
    "HOURGLASS",
    "KITTI_CAMERA",
    "DemoScene",
    "NoiseModel",
    "SampleStreet",
    "SimulatedTruth",
    "Vehicle",
    "demo_scene",
    "kitti_like_pose",
    "sample_drive",
    "sample_scan",
    "sample_street",
    "simulate",
    "simulate_track",
    "yaw_pose",
]

__getattr__, __dir__ = lazy_names(__name__)
