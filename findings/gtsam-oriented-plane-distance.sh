#!/usr/bin/env bash
# gtsam 4.3.0, OrientedPlane3(a, b, c, d): the normal is made a unit vector, the distance is left as it was given, so that
# coefficients of another scale become another plane.
#
# Guess: 2z + 4 = 0 and z + 2 = 0 are one plane, whatever the scale of the four coefficients.
# Seen: (0, 0, 2, 4) is kept as (0, 0, 1, 4), a plane 2 m away from the one that was given. A plane that was fitted by
# least squares or taken from three points has to be divided by the length of its normal first.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv env && env/bin/pip install --quiet gtsam==4.3.0 numpy==2.3.5
env/bin/python - <<'PYTHON'
import gtsam
import numpy as np

plane = gtsam.OrientedPlane3(0.0, 0.0, 2.0, 4.0).planeCoefficients()
same = gtsam.OrientedPlane3(0.0, 0.0, 1.0, 2.0).planeCoefficients()
print("(0, 0, 2, 4) is kept as", plane.tolist(), "and (0, 0, 1, 2) as", same.tolist())
assert np.allclose(plane, [0, 0, 1, 4]) and np.allclose(same, [0, 0, 1, 2])
PYTHON
