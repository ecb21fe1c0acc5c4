#!/usr/bin/env bash
# kitti360scripts 1.0.0, CameraPerspective.cam2image: what is behind the camera is divided by the absolute depth, and pixels are
# rounded to whole ones.
#
# Guess: a point 10 m behind, 1 m to the right and 0.5 m down lies mirrored about the principal point, at (627, 211), as
# K [x, y, z] / z has it; or, since the depth's sign is taken off, at (737, 266) like the one ahead.
# Seen: neither, but at (-627, -211): the negative of the first. Most of what is behind so falls out of the image, and boxes
# through the camera's plane fold to its upper left; but a point 20 m to the right and 5 m below lies at (423, 38), in it.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv env && env/bin/pip install --quiet kitti360scripts==1.0.0 numpy==1.23.5 matplotlib==3.7.5 scikit-image==0.21.0 scipy==1.11.4 opencv-python-headless==4.8.1.78
env/bin/python - <<'PYTHON'
import numpy as np
from kitti360scripts.helpers.project import CameraPerspective

camera = CameraPerspective.__new__(CameraPerspective)
camera.K = np.array([[552.554261, 0, 682.049453, 0], [0, 552.554261, 238.769549, 0], [0, 0, 1, 0]])
points = [(1.0, 0.5, 10.0), (1.0, 0.5, -10.0), (20.0, 5.0, -10.0)]
ahead, behind, aside = (camera.cam2image(np.array(point)[:, None]) for point in points)
print("ahead", *ahead, "behind", *behind, "behind, to the right and below", *aside)
assert (ahead[0], ahead[1]) == (737, 266)
assert (behind[0], behind[1], behind[2]) == (-627, -211, -10) and (aside[0], aside[1]) == (423, 38)
PYTHON
