#!/usr/bin/env bash
# zod 0.8.0 (Zenseact Open Dataset), Box3D.corners: the size is (length, width, height), and from the corner called "rear left
# bottom" to "rear right bottom" it is the length.
#
# Guess: of a car of 4.6 x 1.9 m rear left and rear right are 1.9 m apart.
# Seen: 4.6 m. The length lies along x; by the names of the corners right is x and ahead is y. Whoever takes the two front
# corners for the heading turns every car by a quarter.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv env && env/bin/pip install --quiet zod==0.8.0 'dataclass-wizard<0.30'
env/bin/python - <<'PYTHON'
import numpy as np
from pyquaternion import Quaternion
from zod.constants import Lidar
from zod.data_classes.box import Box3D

text = Box3D.corners.fget.__doc__
names = [line.strip(" -") for line in text.splitlines() if line.strip().startswith("-")]
box = Box3D(center=np.zeros(3), size=np.array([4.6, 1.9, 1.5]), orientation=Quaternion(), frame=Lidar.VELODYNE)
corners = dict(zip(names, box.corners))
side = np.linalg.norm(corners["rear left bottom"] - corners["rear right bottom"])
along = np.linalg.norm(corners["rear left bottom"] - corners["front left bottom"])
print(names[:4], "rear left to rear right:", side, "m, rear left to front left:", along, "m")
assert "length, width, height" in Box3D.__doc__ and abs(side - 4.6) < 1e-9 and abs(along - 1.9) < 1e-9
PYTHON
