#!/usr/bin/env bash
# nuscenes-devkit 1.2.0, prediction.helper.convert_global_coords_to_local(coordinates, translation, rotation): "coordinates in the frame
# given by the rotation quaternion".
#
# Guess: the inverse of the pose, as elsewhere in this devkit: of a car at the origin that looks along x, a point 10 m ahead is (10, 0).
# Seen: (0, 10): ahead is y and left is -x, a quarter turn from the frame of boxes, sensors and ego_pose. PredictHelper's pasts and futures "in
# agent frame" are made by it, and paths that are drawn with the quaternion of the annotation go sideways.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv env && env/bin/pip install --quiet --no-deps nuscenes-devkit==1.2.0 && env/bin/pip install --quiet numpy==1.26.4 pyquaternion==0.9.9 matplotlib==3.9.4 opencv-python-headless==4.11.0.86 scikit-learn==1.5.2 tqdm==4.67.1 cachetools==5.5.0
env/bin/python - <<'PYTHON'
import numpy as np
from nuscenes.prediction.helper import convert_global_coords_to_local
from pyquaternion import Quaternion

turn, place = Quaternion(axis=[0, 0, 1], degrees=30), np.array([100.0, 50.0, 0.0])
ahead_and_left = np.array([turn.rotate(np.array(p)) + place for p in ([10.0, 0, 0], [0.0, 3, 0])])
local = convert_global_coords_to_local(ahead_and_left[:, :2], tuple(place), tuple(turn.elements))
pose = np.array([turn.inverse.rotate(p - place)[:2] for p in ahead_and_left])
print("10 m ahead:", local[0].round(6), "3 m to the left:", local[1].round(6), "by the inverse of the pose:", pose.round(6).tolist())
assert np.allclose(pose, [[10, 0], [0, 3]]) and np.allclose(local, [[0, 10], [-3, 0]])
PYTHON
