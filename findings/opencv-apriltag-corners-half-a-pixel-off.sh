#!/usr/bin/env bash
# OpenCV 5.0.0, aruco.ArucoDetector with CORNER_REFINE_APRILTAG, and pyapriltags 3.4.3.1: corners of an AprilTag of which the place is known.
#
# Guess: all refinements find the same corners, to some hundredths of a pixel, in OpenCV's pixels (the first has its centre at 0).
# Seen: CORNER_REFINE_SUBPIX and CORNER_REFINE_CONTOUR do; CORNER_REFINE_APRILTAG's are half a pixel to the right and below, in every view, as
# AprilTag's own are, whose first pixel has its centre at 0.5. A calibration by them has a principal point half a pixel off, without any larger
# error to tell; in a stereo pair (700 pixels, 0.5 m) of which one camera was calibrated so, what is 50 m away is 3 to 4 m off.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv env && env/bin/pip install --quiet numpy==2.3.5 opencv-python-headless==5.0.0.93 pyapriltags==3.4.3.1
env/bin/python - <<'PYTHON'
import cv2
import numpy as np
from pyapriltags import Detector

family = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
board = np.full((14, 14), 255.0)
board[2:12, 2:12] = cv2.aruco.generateImageMarker(family, 5, 80)[4::8, 4::8]  # a number for each cell
fine = (np.arange(320 * 8) + 0.5) / 8 - 0.5  # eight samples across a pixel, about its centre
places = np.array([grid.ravel() for grid in (*np.meshgrid(fine, fine[: 240 * 8]), np.ones((240 * 8, 320 * 8)))])
rng = np.random.default_rng(0)
detector, errors = Detector(families="tag36h11"), {}
for _ in range(5):
    outline = np.float32([[80, 40], [220, 45], [225, 190], [75, 185]]) + rng.uniform(-20, 20, (4, 2)).astype(np.float32)
    view = cv2.getPerspectiveTransform(np.float32([[0, 0], [14, 0], [14, 14], [0, 14]]), outline).astype(float)
    on_board = np.linalg.inv(view) @ places
    column, row = np.floor(on_board[:2] / on_board[2]).astype(int)
    inside = (column >= 0) & (column < 14) & (row >= 0) & (row < 14)
    image = np.full(inside.shape, 255.0)
    image[inside] = board[row[inside], column[inside]]
    image = image.reshape(240, 8, 320, 8).mean((1, 3)) * 0.7 + 30
    image = cv2.GaussianBlur(image.round().astype(np.uint8), (0, 0), 0.7)
    true = cv2.perspectiveTransform(np.array([[[2.0, 2], [12, 2], [12, 12], [2, 12]]]), view)[0]
    found = {"pyapriltags": detector.detect(image)[0].corners}
    for name in ("SUBPIX", "CONTOUR", "APRILTAG"):
        parameters = cv2.aruco.DetectorParameters()
        parameters.cornerRefinementMethod = getattr(cv2.aruco, f"CORNER_REFINE_{name}")
        found[name] = cv2.aruco.ArucoDetector(family, parameters).detectMarkers(image)[0][0].reshape(4, 2)
    for name, corners in found.items():
        nearest = corners[np.linalg.norm(corners[None] - true[:, None], axis=2).argmin(axis=1)]
        errors.setdefault(name, []).append((nearest - true).mean(axis=0))
for name, offs in errors.items():
    print(f"{name}: corners less true {np.mean(offs, axis=0).round(3)}, over views at most {abs(np.array(offs)).max():.3f}")
    assert abs(np.array(offs) - (0.5 if "APRILTAG" in name.upper() else 0)).max() < 0.1
PYTHON
