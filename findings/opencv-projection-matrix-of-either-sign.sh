#!/usr/bin/env bash
# OpenCV 5.0.0, cv2.decomposeProjectionMatrix(P): a camera matrix, a rotation, and "transVect", the "translation vector T".
#
# Guess: T is the t of P = K [R | t]; P and -P, which project every point to the same pixel, give the same camera.
# Seen: T is the camera's centre in the world, -R' t, as four numbers that are still to be divided by the last: t at its place puts the
# points elsewhere, behind the camera in this example. Of -P, as a fit of P by DLT gives it half the time, the focal lengths are negative and
# the rotation is another by half a turn; nothing tells.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv env && env/bin/pip install --quiet numpy==2.3.5 opencv-python-headless==5.0.0.93
env/bin/python - <<'PYTHON'
import cv2
import numpy as np

K = np.array([[700.0, 0, 320], [0, 700, 240], [0, 0, 1]])
R = cv2.Rodrigues(np.array([0.1, -0.4, 0.2]))[0]
t = np.array([-0.5, 0.2, 6.0])
P = K @ np.column_stack([R, t])

found_K, found_R, T = cv2.decomposeProjectionMatrix(P)[:3]
print("t is", t, "; T is", T.ravel().round(3), ", divided", (T[:3] / T[3]).ravel().round(3), "; the centre is", (-R.T @ t).round(3))
assert np.allclose(found_K, K) and np.allclose(found_R, R) and np.allclose((T[:3] / T[3]).ravel(), -R.T @ t)
assert np.isclose(np.linalg.norm(T), 1) and (R @ [0, 0, 0] + (T[:3] / T[3]).ravel())[2] < 0

other_K, other_R = cv2.decomposeProjectionMatrix(-P)[:2]
turn = np.degrees(np.arccos((np.trace(other_R @ R.T) - 1) / 2))
print("of -P: focal lengths", np.diag(other_K / other_K[2, 2])[:2].round(3), "and a rotation", turn.round(2), "degrees away")
assert np.allclose(np.diag(other_K / other_K[2, 2])[:2], -700) and abs(turn - 180) < 1e-3 and np.linalg.det(other_R) > 0
PYTHON
