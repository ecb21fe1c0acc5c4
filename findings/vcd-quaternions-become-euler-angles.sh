#!/usr/bin/env bash
# vcd 6.0.3 (OpenLABEL), utils.transform_cuboid: a cuboid of ten numbers, with a quaternion, comes back with nine, and Euler angles.
#
# Guess: a cuboid that is moved has the form that it had: x, y, z, qx, qy, qz, qw, length, width, height.
# Seen: nine numbers, whose fourth to sixth are angles about x, y, z. Read by their places as before, the seventh (here the
# length, 4) is taken for the quaternion's real part, and the size has one number too few.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv env && env/bin/pip install --quiet vcd==6.0.3
env/bin/python - <<'PYTHON'
import numpy as np
from vcd import types, utils

half = 0.15
cuboid = [1.0, 2.0, 3.0, 0.0, 0.0, np.sin(half), np.cos(half), 4.0, 2.0, 1.5]
moved = [float(value) for value in utils.transform_cuboid(cuboid, np.eye(4))]
print(len(cuboid), "numbers in,", len(moved), "out:", [round(value, 6) for value in moved])
assert types.cuboid("shape", cuboid).use_quaternion and not types.cuboid("shape", moved).use_quaternion
assert len(moved) == 9 and abs(moved[5] - 0.3) < 1e-9 and moved[6:] == [4.0, 2.0, 1.5]
PYTHON
