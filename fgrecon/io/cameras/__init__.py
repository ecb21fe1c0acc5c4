"""Cameras from other programs' calibration files: KITTI, ROS, OpenCV, nuScenes, Waymo."""

from fgrecon.io.cameras.mounted import MountedCamera
from fgrecon.io.cameras.reader import read_camera

__all__ = ["MountedCamera", "read_camera"]
