#!/usr/bin/env bash
# norfair 2.1.1, a tracked object of several points, one of which its network never found (score 0).
#
# Guess: the point has no estimate, or one that stays out of the way; the others' estimates are filtered, so that it is at least as.
# Seen: `estimate` has a place for it like for the others, which is the network's pixel of the last frame, unfiltered, found or not;
# `live_points` alone says that nobody has seen it. A reader of `estimate` has a corner of the image for a keypoint.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv env && env/bin/pip install --quiet norfair==2.1.1 numpy==1.26.4
env/bin/python - <<'PYTHON'
import numpy as np
from norfair import Detection, Tracker

tracker = Tracker(distance_function="mean_euclidean", distance_threshold=50, initialization_delay=0)
for step in range(3):
    points = np.array([[10.0 + 5 * step, 20.0], [0.0 + 7 * step, 0.0], [50.0 + 5 * step, 60.0]])
    (car,) = tracker.update([Detection(points=points, scores=np.array([0.9, 0.0, 0.9]))])
print(car.estimate.round(2).tolist(), car.live_points.tolist())
assert car.live_points.tolist() == [True, False, True]
assert np.abs(car.estimate[1] - points[1]).max() < 1e-9
assert np.abs(car.estimate[0] - points[0]).max() > 1e-3
PYTHON
