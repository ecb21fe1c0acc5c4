"""What ZOD's evaluation reads of boxes, and how it scores them against themselves: FILE."""

import json
import sys
from pathlib import Path

import numpy as np
from pyquaternion import Quaternion
from zod.eval.detection import DetectionBox, EvalBoxes, evaluate_nuscenes_style

boxes = EvalBoxes.deserialize(json.loads(Path(sys.argv[1]).read_text())["results"], DetectionBox)
corners = []
for box in boxes.all:
    width, length, height = box.size
    ours = [(a * length / 2, b * width / 2, c * height / 2) for a in (-1, 1) for c in (-1, 1) for b in (-1, 1)]
    corners.append((np.array(ours) @ Quaternion(box.rotation).rotation_matrix.T + box.translation).tolist())
said = evaluate_nuscenes_style(boxes, boxes)
json.dump(
    {
        "frames": boxes.sample_tokens,
        "kinds": [box.detection_name for box in boxes.all],
        "corners": corners,
        "scored": {name: float(said[name]) for name in ("mAP", "mATE", "mASE", "mAOE")},
    },
    sys.stdout,
)
