#!/usr/bin/env bash
# OpenCV 5.0.0, cv2.fisheye: its model r = f theta_d(theta) goes on beyond 90 degrees, and fisheyes of 185 degrees are calibrated by it.
#
# Guess: where no ray ahead belongs to a pixel, undistortPoints says so, or the ray points to the side where the pixel is; and
# projectPoints images a point behind the camera's plane on its own side, farther out.
# Seen: a pixel 91 degrees to the right has a ray 89 degrees to the left, without a word, and a point that is 117 degrees to the left
# is imaged on the right, as if it were mirrored through the camera. Without coefficients such rays are all at 90 degrees.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv env && env/bin/pip install --quiet opencv-python-headless==5.0.0.93 numpy==2.4.6
env/bin/python - <<'PYTHON'
import cv2
import numpy as np

K = np.array([[300.0, 0.0, 320.0], [0.0, 300.0, 240.0], [0.0, 0.0, 1.0]])
D = np.array([-0.02, 0.004, -0.003, 0.0004])


def radius(degrees, lens=D):
    t = np.radians(degrees)
    return 300.0 * t * (1 + lens[0] * t**2 + lens[1] * t**4 + lens[2] * t**6 + lens[3] * t**8)


def ray(degrees, lens=D):
    """Degrees of the ray of a pixel that lies so many to the right."""
    pixel = np.array([[[320.0 + radius(degrees, lens), 240.0]]])
    return float(np.degrees(np.arctan(cv2.fisheye.undistortPoints(pixel, K, lens)[0, 0, 0])))


left = np.array([[[-2.0, 0.0, -1.0]]])  # behind the plane, 117 degrees to the left
u = float(cv2.fisheye.projectPoints(left, np.zeros(3), np.zeros(3), K, D)[0].ravel()[0])
model = 320.0 - radius(np.degrees(np.arctan2(2.0, -1.0)))
print("rays of 60, 89, 91, 100 degrees:", [round(ray(d), 3) for d in (60, 89, 91, 100)])
print("the same without coefficients:  ", [round(ray(d, np.zeros(4)), 3) for d in (60, 89, 91, 100)])
print(f"117 degrees to the left: column {u:.1f}, by the model {model:.1f}")
assert abs(ray(89) - 89) < 1e-6 and abs(ray(91) + 89) < 1e-6 and ray(100) < -80
assert abs(ray(91, np.zeros(4)) - 90) < 1e-6
assert u > 320 > model
PYTHON
