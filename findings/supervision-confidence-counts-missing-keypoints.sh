#!/usr/bin/env bash
# supervision 0.31.2, KeyPoints.as_detections: the box leaves out keypoints that were not found (0, 0), the confidence does not.
#
# Guess: the confidence is that of the keypoints that the box encloses: (0.9 + 0.8) / 2 = 0.85.
# Seen: 0.57: a missing point, with a confidence of 0, counts as one that was found badly. A car of which a network sees the
# four points that can be seen, at 0.9 each, has 0.26 for fourteen keypoints, and is dropped by any usual threshold.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv env && env/bin/pip install --quiet supervision==0.31.2 opencv-python-headless==4.12.0.88
env/bin/python - <<'PYTHON'
import numpy as np
import supervision as sv

points = np.array([[[100.0, 50.0], [0.0, 0.0], [140.0, 90.0]]], dtype=np.float32)
found = sv.KeyPoints(xy=points, keypoint_confidence=np.array([[0.9, 0.0, 0.8]], dtype=np.float32)).as_detections()
print("box", found.xyxy[0].tolist(), "confidence", round(float(found.confidence[0]), 3))
assert found.xyxy[0].tolist() == [100.0, 50.0, 140.0, 90.0] and abs(found.confidence[0] - 1.7 / 3) < 1e-6
PYTHON
