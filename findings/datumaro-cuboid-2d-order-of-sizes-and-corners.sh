#!/usr/bin/env bash
# datumaro 1.13.12, Cuboid2D.from_3d(dim, location, rotation_y, P, Tr_velo_to_cam): the corners of a 3D box as pixels.
#
# Guess: `dim` is "3 scalars describing length, width and height", `location` "the middle of the top face" (its docstring), and points
# 1 to 4 are the top's, with 8 below 1 and 5 below 2 (the drawing in the class's docstring).
# Seen: `dim` is height, width, length (KITTI's order), `location` the middle of the bottom, the first four points are the bottom's, and
# point i + 4 is above point i; its visualiser joins i and i + 4 as well. A car 4 m long and 1.5 m high, given as documented, is drawn
# 1.5 m long and 4 m high.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv env && env/bin/pip install --quiet datumaro==1.13.12
env/bin/python - <<'PYTHON'
import numpy as np
from datumaro.components.annotation import Cuboid2D

length, width, height, depth, focal = 4.0, 1.8, 1.5, 20.0, 700.0
P = np.array([[focal, 0, 600, 0], [0, focal, 200, 0], [0, 0, 1, 0]], float)
# a LiDAR that leans by a ten-thousandth: with none at all its turn has no axis
lean = 1e-4
velo_to_cam = np.array([[0, -1, 0, 0], [lean, 0, -1, 0], [1, 0, lean, 0]], float)


def extents(dim):
    points = np.array(Cuboid2D.from_3d(np.array(dim), np.array([0.0, 1.0, depth]), 0.0, P, velo_to_cam).points)
    metres = np.ptp(points, axis=0) * (depth - width / 2) / focal  # at the near side
    return metres, points


documented, _ = extents([length, width, height])
print("dim = length, width, height: drawn", documented.round(2), "m across and up; expected about", (length, height))
assert np.allclose(documented, [height, length], atol=0.15)
kitti, points = extents([height, width, length])
print("dim = height, width, length: drawn", kitti.round(2))
assert np.allclose(kitti, [length, height], atol=0.15)
first, second = points[:4], points[4:]
print("first four v", first[:, 1].round(), "others", second[:, 1].round())
assert (first[:, 1] > second[:, 1]).all()  # v grows downwards: the first four are the bottom's
assert np.allclose(first[:, 0], second[:, 0], atol=0.5)  # i + 4 is above i
near = (focal * 1.0 / (depth - width / 2) + 200, focal * 1.0 / (depth + width / 2) + 200)
assert np.allclose(sorted(first[:, 1]), sorted([*near, *near]), atol=0.5)  # at y = 1.0, the location's
PYTHON
