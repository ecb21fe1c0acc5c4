#!/usr/bin/env bash
# scalabel 0.3.1, Extrinsics.rotation: "3D rotation relative to a world origin in axis-angle representation", says its type.
#
# Guess: (0.3, 0.4, 0.5) is a turn by 0.71 rad about that axis.
# Seen: the library itself reads, and writes, three Euler angles about the fixed axes x, y, z. The two differ by 8 degrees here,
# and agree for turns about a single axis, with which tests are usually made.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv env && env/bin/pip install --quiet scalabel==0.3.1 scipy==1.16.3
env/bin/python - <<'PYTHON'
import numpy as np
from scalabel.label.typing import Extrinsics
from scalabel.label.utils import get_matrix_from_extrinsics
from scipy.spatial.transform import Rotation


def off(rotation):
    matrix = get_matrix_from_extrinsics(Extrinsics(location=(0, 0, 0), rotation=rotation))[:3, :3]
    return np.degrees((Rotation.from_matrix(matrix).inv() * Rotation.from_rotvec(rotation)).magnitude())


print("one axis:", round(off((0.0, 0.7, 0.0)), 6), "degrees, three:", round(off((0.3, 0.4, 0.5)), 2))
assert off((0.0, 0.7, 0.0)) < 1e-6 and 8.0 < off((0.3, 0.4, 0.5)) < 8.3
PYTHON
