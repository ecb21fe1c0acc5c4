#!/usr/bin/env bash
# evo 1.38.1, file_interface.read_tum_trajectory_file: quaternions of any length and lines in any order are taken as they are.
#
# Guess: quaternions are made unit ones, or refused; poses come in the order of their times.
# Seen: neither. Matrices are made of the unit quaternion, but what is written again has the length that was read; times
# stay out of order, and only check(), which reading does not call, says so.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv env && env/bin/pip install --quiet evo==1.38.1
env/bin/python - <<'PYTHON'
import numpy as np
from evo.tools import file_interface

open("poses.txt", "w").write("2 1 2 3 0 0 0 2\n1 0 0 0 0 0 0.6 0.6\n")
poses = file_interface.read_tum_trajectory_file("poses.txt")
file_interface.write_tum_trajectory_file("again.txt", poses)
lengths = np.linalg.norm(np.loadtxt("again.txt")[:, 4:], axis=1)
print("times", poses.timestamps.tolist(), "lengths of quaternions written again", lengths.round(3).tolist())
print("rotation", poses.poses_se3[1][:2, :2].round(6).tolist(), "check", poses.check())
assert poses.timestamps.tolist() == [2.0, 1.0] and lengths[0] == 2.0
assert np.allclose(poses.poses_se3[1][:2, :2], [[0, -1], [1, 0]]) and not poses.check()[0]
PYTHON
