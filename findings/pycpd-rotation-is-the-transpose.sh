#!/usr/bin/env bash
# pycpd 2.0.0, RigidRegistration(X=target, Y=source): s, R and t as register() and get_registration_parameters() give them back.
#
# Guess: the "DxD rotation matrix" R turns the source into the target, x = s R y + t, as in the paper that the class is written after.
# Seen: it is that matrix's transpose, for points as rows: x = s y R + t. A source that has to turn by 30 degrees comes with a matrix that turns by
# -30; with R @ y + t a car that has a nose 2 m ahead is 2 m off there, and small turns hide it.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv env && env/bin/pip install --quiet pycpd==2.0.0 numpy==2.3.5 scipy==1.16.3
env/bin/python - <<'PYTHON'
import numpy as np
from pycpd import RigidRegistration
from scipy.spatial.transform import Rotation

source = np.random.default_rng(0).uniform([-2, -0.9, 0], [2, 0.9, 1.5], (200, 3))
turn, shift = Rotation.from_euler("z", 30, degrees=True), np.array([0.3, -0.2, 0.1])
moved, (scale, matrix, offset) = RigidRegistration(X=turn.apply(source) + shift, Y=source).register()
heading = np.degrees(np.arctan2(matrix[1, 0], matrix[0, 0]))
nose = np.array([2.0, 0.0, 0.5])
off = np.linalg.norm(scale * matrix @ nose + offset - (turn.apply(nose) + shift))
rows = np.linalg.norm(scale * nose @ matrix + offset - (turn.apply(nose) + shift))
print(f"turned by 30 degrees; matrix turns by {heading:.2f}; the nose is {off:.2f} m off with R @ y, {rows:.4f} m with y @ R")
assert np.allclose(moved, turn.apply(source) + shift, atol=1e-3)
assert abs(heading + 30) < 0.05 and 1.9 < off < 2.1 and rows < 1e-3
PYTHON
