#!/usr/bin/env bash
# opencv-python-headless 5.0.0.93, cv2.stereoRectify: a translation of shape (3,) fails inside gemm; (3, 1) works.
#
# Guess: T may be a numpy vector of three numbers, as every version of OpenCV 4 takes it.
# Seen: 4.12 takes both shapes and gives the same projections. 5.0 takes the column alone; of a vector it says
# "(-215:Assertion failed) a_size.width == len in function 'gemm'", which names neither the argument nor its shape.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
cat > check.py <<'PYTHON'
import sys
import cv2
import numpy as np

K, lens, size, turn = np.array([[300.0, 0, 160], [0, 300, 60], [0, 0, 1]]), np.zeros(5), (320, 120), np.eye(3)
vector = np.array([-0.5, 0.0, 0.0])
column = cv2.stereoRectify(K, lens, K, lens, size, turn, vector[:, None])[3]
try:
    flat = cv2.stereoRectify(K, lens, K, lens, size, turn, vector)[3]
    said = "the same" if np.allclose(flat, column) else "another projection"
except cv2.error as error:
    said = error.err
print(cv2.__version__, "column:", column[0].round(1).tolist(), "vector:", said)
assert abs(column[0, 3] + 150.0) < 1e-6
assert (said == "the same") if cv2.__version__.startswith("4.") else said == "a_size.width == len", said
PYTHON
for version in 4.12.0.88 5.0.0.93; do
  python3 -m venv "env-$version" && "env-$version/bin/pip" install --quiet "opencv-python-headless==$version"
  "env-$version/bin/python" check.py
done
