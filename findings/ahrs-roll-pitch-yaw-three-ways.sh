#!/usr/bin/env bash
# ahrs 0.4.0, roll, pitch and yaw: DCM(rpy=angles), Quaternion(rpy=angles), and the to_rpy() of a DCM.
#
# Guess: the three belong together: DCM(rpy=(0.2, 0.3, 0.5)) is Rz(0.5) Ry(0.3) Rx(0.2), as the quaternion is, and to_rpy() gives the angles back.
# Seen: the quaternion is, and gives them back. DCM ("array with roll->pitch->yaw angles") takes the first of them about z and the last
# about x; to_rpy() of either matrix gives other angles, of the transposed one and with a minus: a pure yaw of 0.5 comes back as -0.5 from
# the right matrix.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv env && env/bin/pip install --quiet ahrs==0.4.0 numpy==2.3.5 scipy==1.16.3
env/bin/python - <<'PYTHON'
import numpy as np
from ahrs import DCM, Quaternion
from scipy.spatial.transform import Rotation

angles = np.array([0.2, 0.3, 0.5])
right = Rotation.from_euler("ZYX", angles[::-1]).as_matrix()
quaternion, matrix = Quaternion(rpy=angles), DCM(rpy=angles)
order = Rotation.from_euler("ZYX", angles).as_matrix()
back = DCM(right).to_rpy(), matrix.to_rpy(), DCM(Rotation.from_euler("z", 0.5).as_matrix()).to_rpy()
print("quaternion is Rz(yaw) Ry(pitch) Rx(roll):", np.allclose(quaternion.to_DCM(), right), "gives back", np.array(quaternion.to_angles()).round(3))
print("DCM is:", np.allclose(matrix, right), "but Rz(roll) Ry(pitch) Rx(yaw):", np.allclose(matrix, order))
print("to_rpy of the quaternion's matrix", back[0].round(3), "of the DCM", back[1].round(3), "of a yaw of 0.5", back[2].round(3))
assert np.allclose(quaternion.to_DCM(), right) and np.allclose(quaternion.to_angles(), angles)
assert np.allclose(matrix, order) and not np.allclose(matrix, right, atol=0.1)
assert not any(np.allclose(found, angles, atol=0.1) for found in back[:2]) and np.allclose(back[2], [0, 0, -0.5])
PYTHON
