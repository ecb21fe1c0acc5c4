#!/usr/bin/env bash
# kitti360scripts 1.0.0, CameraPerspective.cam2image: what is behind the camera is projected by the absolute depth, and pixels
# are rounded to whole ones.
#
# Guess: a point 10 m behind and 1 m to the right lies on the other side of the principal point, mirrored, as K [x, y, z] / z has it.
# Seen: it lies exactly where its mirror image in front of the camera does. Without the depth's sign, which is given beside
# it, a car behind the camera looks like one ahead; a box through the camera's plane folds over.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv env && env/bin/pip install --quiet kitti360scripts==1.0.0 numpy==1.23.5 matplotlib==3.7.5 scikit-image==0.21.0 scipy==1.11.4 opencv-python-headless==4.8.1.78
env/bin/python - <<'PYTHON'
import numpy as np
from kitti360scripts.helpers.project import CameraPerspective

camera = CameraPerspective.__new__(CameraPerspective)
camera.K = np.array([[552.554261, 0, 682.049453, 0], [0, 552.554261, 238.769549, 0], [0, 0, 1, 0]])
ahead, behind = (camera.cam2image(np.array([[1.0], [0.5], [z]])) for z in (10.0, -10.0))
print("ahead", *ahead, "behind", *behind)
assert ahead[0] == 737 and ahead[1] == 266  # 737.3, 266.4
pinhole = 682.049453 - 552.554261 / 10
assert behind[2] == -10 and abs(behind[0][0] - (552.554261 * 1.0 - 6820.49453) / 10) < 1
print("a pinhole has it at column", pinhole, "the devkit at", behind[0][0])
PYTHON
