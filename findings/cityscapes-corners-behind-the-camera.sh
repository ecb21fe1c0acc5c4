#!/usr/bin/env bash
# cityscapesscripts 2.3.0, Box3dImageTransform: corners of a box behind the camera have pixels, amid the image, and nothing marks them.
#
# Guess: get_vertices_2d leaves them out or gives NaN, and the 2D box is None.
# Seen: a car 20 m behind is at (1278, 396) of an image of 2048 x 1024; its 2D box is [0, 0, 0, 0], which is a box as well.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv env && env/bin/pip install --quiet cityscapesscripts==2.3.0
env/bin/python - <<'PYTHON'
import numpy as np
from cityscapesscripts.helpers.box3dImageTransform import CRS_V, Box3dImageTransform, Camera

mount = np.eye(4)[:3]
mount[:, 3] = [-1.7, -0.1, -1.22]
box = Box3dImageTransform(Camera(2262.52, 2265.3, 1096.98, 513.137, mount.tolist()))
box.initialize_box([4.0, 2.0, 1.5], [1, 0, 0, 0], [-20.0, 1.0, 0.75], CRS_V)
corner = box.get_vertices_2d()["BLB"]
print("corner behind the camera:", corner.round(1), "2D box:", box.get_amodal_box_2d())
assert 0 < corner[0] < 2048 and 0 < corner[1] < 1024 and box.get_amodal_box_2d() == [0.0, 0.0, 0.0, 0.0]
PYTHON
