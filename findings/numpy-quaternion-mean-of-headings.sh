#!/usr/bin/env bash
# numpy-quaternion 2024.0.13, mean_rotor_in_chordal_metric: the mean of quaternions, "closest to all R in the least-squares sense".
#
# Guess: it is a mean of rotations, as scipy's Rotation.mean: headings of 178 and -178 degrees have one of 180.
# Seen: 0 degrees, the opposite. The numbers are added up as they are, q and -q count as different, and from_rotation_vector gives the two
# headings quaternions of opposite signs. Headings of 90 and 91 degrees, the second with the other sign, as networks and files have it,
# have a mean of -89.5 degrees.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv env && env/bin/pip install --quiet numpy-quaternion==2024.0.13 numpy==2.3.5 scipy==1.16.3
env/bin/python - <<'PYTHON'
import numpy as np
import quaternion
from scipy.spatial.transform import Rotation


def headings(quaternions):
    mean = quaternion.as_rotation_matrix(quaternion.mean_rotor_in_chordal_metric(quaternions))
    right = Rotation.from_quat(quaternion.as_float_array(quaternions), scalar_first=True).mean().as_matrix()
    return [float(np.degrees(np.arctan2(R[1, 0], R[0, 0]))) for R in (mean, right)]


backwards = headings(quaternion.from_rotation_vector(np.radians([[0, 0, 178.0], [0, 0, -178.0]])))
aside = quaternion.from_rotation_vector(np.radians([[0, 0, 90.0], [0, 0, 91.0]]))
aside[1] = -aside[1]
signs = headings(aside)
print("mean of 178 and -178, and scipy's:", backwards, "; of 90 and 91 with two signs:", signs)
assert abs(backwards[0]) < 1e-6 and abs(abs(backwards[1]) - 180) < 1e-6
assert abs(signs[0] - 90.5) > 90 and abs(signs[1] - 90.5) < 1e-6
PYTHON
