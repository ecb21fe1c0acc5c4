#!/usr/bin/env bash
# zod 0.8.0 (Zenseact Open Dataset), Calibration.transform_points(points, from_frame, to_frame): "Transform points from one frame to another".
#
# Guess: extrinsics are "pose in the ego frame", so points of the LiDAR come into the camera's frame by inv(ego_T_camera) @ ego_T_lidar.
# Seen: by ego_T_camera @ ego_T_lidar, without an inverse. A point 9.5 m ahead of the camera is 1.2 m ahead and 11 m above it; to
# the ego frame it is right, from the ego frame to a sensor it is the reverse of what is asked for. Its own drawings
# (lidar_on_image.py) invert the pose themselves and do not call it.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv env && env/bin/pip install --quiet zod==0.8.0 'dataclass-wizard<0.30'
env/bin/python - <<'PYTHON'
import numpy as np
from zod.constants import EGO, Camera, Lidar
from zod.data_classes.calibration import Calibration

ego_T_camera = np.array([[0, 0, 1, 1.5], [-1, 0, 0, 0], [0, -1, 0, 1.2], [0, 0, 0, 1.0]])  # looks ahead, y down
ego_T_lidar = np.array([[0, 1, 0, 1.0], [-1, 0, 0, 0], [0, 0, 1, 2.0], [0, 0, 0, 1.0]])  # its y is ahead
rest = {"intrinsics": np.eye(3, 4).tolist(), "distortion": [0] * 4, "undistortion": [0] * 4}
front = {"extrinsics": ego_T_camera.tolist(), "lidar_extrinsics": ego_T_lidar.tolist(), **rest}
calibration = Calibration.from_dict({"FC": {**front, "image_dimensions": [3848, 2168], "field_of_view": [120, 67]}})

point = np.array([[0.0, 10.0, 0.0]])  # of the LiDAR: ten metres ahead
whole = np.append(point[0], 1.0)
theirs = calibration.transform_points(point, Lidar.VELODYNE, Camera.FRONT)[0]
expected = (np.linalg.inv(ego_T_camera) @ ego_T_lidar @ whole)[:3]
print("in the camera's frame (right, down, ahead):", theirs, "expected", expected)
assert np.allclose(theirs, (ego_T_camera @ ego_T_lidar @ whole)[:3]) and not np.allclose(theirs, expected)
assert np.allclose(calibration.transform_points(point, Lidar.VELODYNE, EGO)[0], (ego_T_lidar @ whole)[:3])
there = calibration.transform_points(point, Lidar.VELODYNE, EGO)
back = calibration.transform_points(there, EGO, Lidar.VELODYNE)[0]
print("there and back:", back, "was", point[0])
assert not np.allclose(back, point[0])
PYTHON
