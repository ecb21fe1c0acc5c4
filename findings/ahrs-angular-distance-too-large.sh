#!/usr/bin/env bash
# ahrs 0.4.0, utils.metrics.angular_distance(R1, R2): "the angular distance between two rotations", the norm of log(R1 R2'), "the usual
# euclidean norm of the vector".
#
# Guess: between no turn and a quarter turn it is pi / 2, as qad, this module's angle between quaternions, says.
# Seen: 2.22, larger by sqrt(2) at every angle: the norm is that of the matrix, in which each number of the vector stands twice. A limit of
# 10 degrees is one of 7, and an error of 10 is told as 14.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv env && env/bin/pip install --quiet ahrs==0.4.0 numpy==2.3.5 scipy==1.16.3
env/bin/python - <<'PYTHON'
import numpy as np
from ahrs.utils.metrics import angular_distance, qad
from scipy.spatial.transform import Rotation

start = Rotation.from_euler("xyz", [0.3, -0.2, 0.1])
ratios = []
for degrees in (1, 10, 90, 150):
    end = start * Rotation.from_euler("z", degrees, degrees=True)
    matrices = angular_distance(start.as_matrix(), end.as_matrix())
    quaternions = qad(start.as_quat(scalar_first=True), end.as_quat(scalar_first=True))
    ratios.append(matrices / np.radians(degrees))
    print(f"turned by {degrees}: angular_distance {np.degrees(matrices):.2f}, qad {np.degrees(quaternions):.2f} degrees")
    assert np.isclose(np.degrees(quaternions), degrees, atol=1e-3)
assert np.allclose(ratios, np.sqrt(2), rtol=1e-3)
PYTHON
