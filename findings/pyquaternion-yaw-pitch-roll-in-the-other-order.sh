#!/usr/bin/env bash
# pyquaternion 0.9.9, Quaternion.yaw_pitch_roll: "intrinsic Tait-Bryan angles following the z-y'-x'' convention".
#
# Guess: of Rz(0.5) Ry(0.3) Rx(0.2), which is that convention, yaw is 0.5, the heading of the turned x axis seen from above.
# Seen: (0.463, 0.357, 0.038): the angles of Rx(roll) Ry(pitch) Rz(yaw), the order of x-y'-z''; a note in the same docstring gives that matrix. Angles
# about one axis agree. The yaw of a car that leans on a slope is not its heading; of a camera that looks ahead along z, as in nuScenes, yaw stays 0
# when the car turns on the spot, and pitch changes instead.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv env && env/bin/pip install --quiet pyquaternion==0.9.9 numpy==2.3.5 scipy==1.16.3
env/bin/python - <<'PYTHON'
import numpy as np
from pyquaternion import Quaternion
from scipy.spatial.transform import Rotation


def angles(rotation):
    return np.array(Quaternion(rotation.as_quat(scalar_first=True)).yaw_pitch_roll)


car = Rotation.from_euler("ZYX", [0.5, 0.3, 0.2])
ahead = car.apply([1, 0, 0])
print("of Rz(0.5) Ry(0.3) Rx(0.2):", angles(car).round(3), "heading:", round(float(np.arctan2(ahead[1], ahead[0])), 3))
assert np.allclose(angles(car), car.as_euler("XYZ")[::-1]) and not np.allclose(angles(car), [0.5, 0.3, 0.2], atol=0.03)
assert np.isclose(np.arctan2(ahead[1], ahead[0]), 0.5) and np.allclose(angles(Rotation.from_euler("Z", 0.5)), [0.5, 0, 0])

mount = Rotation.from_matrix([[0, 0, 1], [-1, 0, 0], [0, -1, 0]])  # x of the camera to the right, y down, z ahead
for turn in (0.0, 0.3, 0.6):
    print("camera of a car that heads to", turn, ":", angles(Rotation.from_euler("z", turn) * mount).round(3))
turned = np.diff([angles(Rotation.from_euler("z", turn) * mount) for turn in (0.3, 0.6)], axis=0)[0]
assert np.allclose(turned, [0, -0.3, 0])
PYTHON
