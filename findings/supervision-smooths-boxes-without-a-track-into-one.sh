#!/usr/bin/env bash
# trackers 2.6.1 beside supervision 0.31.2, both of one maker: boxes that a tracker does not follow yet, smoothed.
#
# Guess: a tracker gives back the boxes that it follows, or gives each an id; DetectionsSmoother makes each box smoother.
# Seen: boxes that ByteTrackTracker does not follow all come back with the id -1, and the smoother takes them for one object: two parked
# cars (x 20 to 120 and 300 to 400) of score 0.55 become one box, 160 to 260, where no car is. LineZone of the same package leaves -1 out.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv env && env/bin/pip install --quiet trackers==2.6.1 supervision==0.31.2
env/bin/python - <<'PYTHON'
import numpy as np
import supervision as sv
from trackers import ByteTrackTracker

CARS = np.array([[20.0, 100, 120, 180], [300, 100, 400, 180]])
tracker, smoother = ByteTrackTracker(), sv.DetectionsSmoother(length=5)
cars = sv.Detections(xyxy=CARS, confidence=np.array([0.55, 0.55]), class_id=np.array([2, 2]))
followed = tracker.update(cars)
smooth = smoother.update_with_detections(followed)
print("ids:", followed.tracker_id, "smoothed:", smooth.xyxy.tolist())
assert followed.tracker_id.tolist() == [-1, -1]
assert smooth.xyxy.tolist() == [CARS.mean(axis=0).tolist()] == [[160.0, 100.0, 260.0, 180.0]]
PYTHON
