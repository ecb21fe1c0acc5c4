#!/usr/bin/env bash
# OpenCV 5.0.0, cv2.SIFT_create() and cv2.ORB_create(): keypoints of an image beside those of its mirror image, mirrored back.
#
# Guess: both have them at the same spots on average, whatever a detector's scale: left and right are alike.
# Seen: SIFT's are half a pixel apart at all scales: each is a quarter of a pixel to the right of its spot (and below it), as the image, which
# is doubled first, is; with enable_precise_upscale=True, which is not the default, nothing is left. ORB's first level is exact, from
# the second on they are to the left and above, by more than a pixel on coarse ones. Between two images of one scale it cancels; poses from
# known points, matches across scales and anything beside keypoints of other detectors have it.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv env && env/bin/pip install --quiet numpy==2.3.5 scipy==1.16.3 opencv-python-headless==5.0.0.93
env/bin/python - <<'PYTHON'
import cv2
import numpy as np
from scipy.ndimage import gaussian_filter

rng = np.random.default_rng(0)
image = sum(gaussian_filter(rng.normal(size=(480, 640)), blur) * blur for blur in (1.5, 3, 6, 12, 20))
image = np.clip(image / image.std() * 40 + 128, 0, 255).round().astype(np.uint8)


def shift(detector, level):
    """Pixels that keypoints of an octave lie to the right and below: half of what the image and its mirror image differ by."""
    answer = []
    for axis in (1, 0):
        keypoints = []
        for picture in (image, np.ascontiguousarray(np.flip(image, axis))):
            found = [keypoint for keypoint in detector.detect(picture) if keypoint.octave & 255 == level]
            keypoints.append(np.array([keypoint.pt for keypoint in found]))
        keypoints[1][:, 1 - axis] = image.shape[axis] - 1 - keypoints[1][:, 1 - axis]
        gaps = keypoints[0][:, None] - keypoints[1][None]
        nearest = np.linalg.norm(gaps, axis=2).argmin(axis=1)
        gaps = gaps[np.arange(len(gaps)), nearest]
        answer.append(np.median(gaps[np.linalg.norm(gaps, axis=1) < 6, 1 - axis]) / 2)
    return np.array(answer)


plain, precise, orb = cv2.SIFT_create(), cv2.SIFT_create(enable_precise_upscale=True), cv2.ORB_create(3000)
for level in (255, 0, 1):
    print("SIFT, octave", level if level < 255 else -1, shift(plain, level).round(3), "precise", shift(precise, level).round(3))
    assert abs(shift(plain, level) - 0.25).max() < 0.04 and abs(shift(precise, level)).max() < 0.04
levels = np.array([shift(orb, level) for level in range(8)])
print("ORB, levels 0 to 7, to the right:", levels[:, 0].round(2), "below:", levels[:, 1].round(2))
assert abs(levels[0]).max() < 0.02 and (levels[1:] < -0.05).all() and levels.min() < -1
PYTHON
