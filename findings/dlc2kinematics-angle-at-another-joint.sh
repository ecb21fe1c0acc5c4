#!/usr/bin/env bash
# dlc2kinematics 0.0.7, compute_joint_angles(df, {"elbow": ["shoulder", "elbow", "wrist"]}): angles of keypoints that DeepLabCut found.
#
# Guess: the angle at the second of the three, between its two arms: 60 degrees for an arm that is bent so far, 180 for a straight one.
# Seen: the three are picked out of the table, in the table's order: the angle is at whichever keypoint stands between the others there, and the
# three lists for shoulder, elbow and wrist give one number. And it is what the path turns by, 120 and 0 degrees. The project has mended
# both (pull requests 44 and 46, 2023), without a release since: this is what pip installs.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv env
env/bin/pip install --quiet numpy==1.24.4 pandas==1.5.3 scipy==1.15.3 matplotlib==3.10.7 sympy==1.14.0 ruamel.yaml==0.18.16
env/bin/pip install --quiet --no-deps dlc2kinematics==0.0.7 scikit-kinematics==0.10.4
env/bin/python -W ignore - <<'PYTHON'
import contextlib
import io
import sys
from unittest.mock import MagicMock

for name in ("umap", "c3d", "sklearn", "sklearn.decomposition", "easygui"):  # for drawings, other formats and components, not for angles
    sys.modules[name] = MagicMock()
import numpy as np
import pandas as pd
from dlc2kinematics import compute_joint_angles

POINTS = {"shoulder": (0.0, 0.0), "elbow": (100.0, 0.0), "wrist": (75.0, 43.3013)}  # pixels; 60 degrees at the elbow
ORDERS = (["shoulder", "elbow", "wrist"], ["elbow", "shoulder", "wrist"], ["shoulder", "wrist", "elbow"])


def inner(joint):
    """The angle at a keypoint, between its arms to the other two."""
    arms = [np.subtract(POINTS[other], POINTS[joint]) for other in POINTS if other != joint]
    return np.degrees(np.arccos(np.dot(*arms) / np.linalg.norm(arms, axis=1).prod()))


def told(columns, keypoints):
    """The angle of a table with these columns for this list of keypoints."""
    names = pd.MultiIndex.from_product([["net"], columns, ["x", "y", "likelihood"]], names=["scorer", "bodyparts", "coords"])
    table = pd.DataFrame([[number for part in columns for number in (*POINTS[part], 0.99)]] * 3, columns=names)
    with contextlib.redirect_stdout(io.StringIO()):
        return compute_joint_angles(table, {"angle": keypoints}, save=False)["angle"][0]


for columns in ORDERS:
    angles = [told(columns, keypoints) for keypoints in ORDERS]
    middle = columns[1]
    print(f"table in the order {columns}: {np.round(angles, 2)} for any list; the angle at the {middle} is {inner(middle):.2f}")
    assert np.ptp(angles) < 1e-9 and abs(angles[0] - (180 - inner(middle))) < 0.01
assert abs(inner("elbow") - 60) < 0.01
PYTHON
