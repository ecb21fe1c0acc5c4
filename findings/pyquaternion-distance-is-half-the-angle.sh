#!/usr/bin/env bash
# pyquaternion 0.9.9, Quaternion.distance (of the quaternions that nuScenes' devkit and its relatives use): "the length of the
# geodesic arc connecting q0 to q1".
#
# Guess: between no turn and a quarter turn it is pi / 2, the angle, whichever of q and -q a rotation is given by.
# Seen: pi / 4, half the angle, and 3 pi / 4 for the same rotation with the other sign. A limit on it lets
# through twice the turn that was meant. abs((q0.inverse * q1).angle) is the angle, for both signs.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv env && env/bin/pip install --quiet pyquaternion==0.9.9 numpy==2.3.5
env/bin/python - <<'PYTHON'
import numpy as np
from pyquaternion import Quaternion

none, quarter = Quaternion(), Quaternion(axis=[0, 0, 1], degrees=90)
assert np.allclose(quarter.rotation_matrix, (-quarter).rotation_matrix)
plain, other = Quaternion.distance(none, quarter), Quaternion.distance(none, -quarter)
angles = [abs((none.inverse * q).angle) for q in (quarter, -quarter)]
print("degrees: distance", np.degrees(plain), "of the other sign", np.degrees(other), "angles", np.degrees(angles))
assert np.isclose(plain, np.pi / 4) and np.isclose(other, 3 * np.pi / 4) and np.allclose(angles, np.pi / 2)
PYTHON
