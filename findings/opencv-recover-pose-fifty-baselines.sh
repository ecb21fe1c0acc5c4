#!/usr/bin/env bash
# OpenCV 5.0.0, cv2.recoverPose(E, points1, points2, K): the pose out of the four of an essential matrix, with a threshold that this call
# does not show: a point farther away than fifty times the baseline counts for none of the four.
#
# Guess: of exact matches and the exact E the pose is right wherever the points lie in front of both cameras; far points only weigh less.
# Seen: a car that drives half a metre between two images, with all it sees 30 to 80 m away, has 0 good points and a wrong pose, without
# an error. With 1 m between the images the pose is right, and 70 of 200 exact points count, which look like a bad match. The longer
# call with `distanceThresh=1000` finds the pose and all 200 points.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv env && env/bin/pip install --quiet numpy==2.3.5 opencv-python-headless==5.0.0.93
env/bin/python - <<'PYTHON'
import cv2
import numpy as np

K = np.array([[720.0, 0, 620], [0, 720, 190], [0, 0, 1]])
turn = cv2.Rodrigues(np.array([0.0, 0.02, 0.0]))[0]


def found(near, far, step, **threshold):
    random = np.random.default_rng(0)
    z, u, v = random.uniform(near, far, 200), random.uniform(0, 1240, 200), random.uniform(0, 370, 200)
    points = np.c_[(u - 620) / 720 * z, (v - 190) / 720 * z, z]
    shift = np.array([0.05, 0.0, -step])
    moved = points @ turn.T + shift
    cross = np.array([[0, -shift[2], shift[1]], [shift[2], 0, -shift[0]], [-shift[1], shift[0], 0]])
    first, second = (p[:, :2] / p[:, 2:] * 720 + [620, 190] for p in (points, moved))
    count, R, t = cv2.recoverPose(cross @ turn, first, second, K, **threshold)[:3]
    right = np.allclose(R, turn, atol=1e-6) and np.allclose(t[:, 0], shift / np.linalg.norm(shift), atol=1e-6)
    return count, right


near, middle, far = found(10, 40, 1.0), found(30, 80, 1.0), found(30, 80, 0.5)
wide = found(30, 80, 0.5, distanceThresh=1000.0)
print("points that count of 200, and whether the pose is right:", near, middle, far, "with distanceThresh", wide)
assert near == (200, True) and middle[1] and 0 < middle[0] < 120
assert far == (0, False) and wide == (200, True)
PYTHON
