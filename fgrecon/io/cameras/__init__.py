"""Cameras from other programs' calibration files: KITTI, ROS, OpenCV, nuScenes, Waymo."""

from fgrecon.io.cameras.camera_source import read_camera
from fgrecon.io.cameras.rigs import MountedCamera

__all__ = ["MountedCamera", "read_camera"]
