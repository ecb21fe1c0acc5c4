#!/usr/bin/env bash
# nuscenes-devkit 1.2.0, RadarPointCloud.rotate and transform, through which from_file_multisweep brings sweeps into one frame.
#
# Guess: the velocities of the points turn with them, as a Box's velocity does in Box.rotate of the same file.
# Seen: positions turn, vx, vy and their compensated forms stay those of the sensor's frame. A point straight to the left of the car, seen by a
# radar that looks to the left, with 5 m/s away from it, is still at 5 m/s ahead; sweeps of five radars in one cloud mix five frames.
# TruckScenes' devkit, which follows this one, turns them.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv env && env/bin/pip install --quiet --no-deps nuscenes-devkit==1.2.0 && env/bin/pip install --quiet numpy==1.26.4 pyquaternion==0.9.9 matplotlib==3.9.4 opencv-python-headless==4.11.0.86 scikit-learn==1.5.2 tqdm==4.67.1 cachetools==5.5.0
env/bin/python - <<'PYTHON'
import numpy as np
from nuscenes.utils.data_classes import Box, RadarPointCloud
from pyquaternion import Quaternion

left = Quaternion(axis=[0, 0, 1], degrees=90)
cloud = np.zeros((18, 1))
cloud[0], cloud[6], cloud[8] = 20.0, 5.0, 5.0  # x, vx, vx_comp of the radar's frame
points = RadarPointCloud(cloud.copy())
points.transform(left.transformation_matrix)
turned = RadarPointCloud(cloud.copy())
turned.rotate(left.rotation_matrix)
box = Box([20.0, 0, 0], [2, 4, 1.5], Quaternion(), velocity=(5.0, 0, 0))
box.rotate(left)
print("position", points.points[:3, 0].round(3), "velocities", points.points[6:10, 0], "of a box", box.velocity.round(3))
for found in (points, turned):
    assert np.allclose(found.points[:3, 0], [0, 20, 0]) and np.allclose(found.points[6:10, 0], [5, 0, 5, 0])
assert np.allclose(box.velocity, [0, 5, 0])
PYTHON
