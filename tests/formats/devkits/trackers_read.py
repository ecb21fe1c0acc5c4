"""What fgrecon (ROOT) reads of trackers' own objects of a car and a person."""

import json
import sys

sys.path.insert(0, sys.argv[1])

import motpy
import norfair
import numpy as np
import supervision

from fgrecon.perception.protocols import boxes_from

CAR, PERSON = np.array([10.0, 20.0, 110.0, 80.0]), np.array([205.0, 6.0, 227.0, 88.0])
motion, tracker = motpy.MultiObjectTracker(dt=0.1), norfair.Tracker("iou", 0.5, initialization_delay=1)
for _ in range(4):
    motion.step([motpy.Detection(box=box, score=0.5, class_id=n) for box, n in ((CAR, 2), (PERSON, 0))])
    seen = [
        norfair.Detection(points=box.reshape(2, 2), scores=np.array([0.5, 0.5]), label=kind)
        for box, kind in ((CAR, "car"), (PERSON, "person"))
    ]
    followed = tracker.update(seen)
xyxy, rest = np.stack([PERSON, CAR]), {"confidence": np.array([0.9, 0.5]), "tracker_id": np.array([3, 7])}
found = {
    "motpy": motion.active_tracks(),
    "norfair": followed,
    "norfair detections": seen,
    "supervision": supervision.Detections(xyxy=xyxy, class_id=np.array([0, 2]), **rest),
    "supervision names": supervision.Detections(xyxy=xyxy, data={"class_name": np.array(["person", "car"])}, **rest),
    "empty": supervision.Detections.empty(),
}
plain = {
    name: [[box.corners.tolist(), box.kind, box.score, box.track] for box in boxes_from(given)]
    for name, given in found.items()
}
json.dump(plain, sys.stdout)
