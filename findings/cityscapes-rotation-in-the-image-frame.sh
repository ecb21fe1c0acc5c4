#!/usr/bin/env bash
# cityscapesscripts 2.3.0, Box3dImageTransform.get_parameters(CRS_S): in the camera's frame (x right, y down, z ahead) a box keeps
# axes of its own that are right, down, ahead as well, beside its size as length, width, height.
#
# Guess: the quaternion turns the box's axes (length, width, height) into the frame; of a car that drives straight ahead it
# takes the first axis to z.
# Seen: it is the identity: the length is along the third axis, the width along the first. Size and rotation as they are given
# make a car that stands across the road.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv env && env/bin/pip install --quiet cityscapesscripts==2.3.0
env/bin/python - <<'PYTHON'
import numpy as np
from cityscapesscripts.helpers.box3dImageTransform import CRS_S, CRS_V, Box3dImageTransform, Camera

camera = Camera(2262.5, 2265.3, 1097.0, 513.1, np.eye(4)[:3].tolist())
box = Box3dImageTransform(camera)
box.initialize_box([4.6, 1.9, 1.5], [1, 0, 0, 0], [20.0, 0.0, 0.0], CRS_V)
size, centre, rotation = box.get_parameters(CRS_S)
corners = np.array(list(box.get_vertices(CRS_S).values()))
print("size", size, "centre", centre, "rotation", rotation, "extent right, down, ahead:", np.ptp(corners, axis=0))
assert np.allclose(size, [4.6, 1.9, 1.5]) and np.allclose(rotation.rotation_matrix, np.eye(3))
assert np.allclose(np.ptp(corners, axis=0), [1.9, 1.5, 4.6])
PYTHON
