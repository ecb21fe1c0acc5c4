#!/usr/bin/env bash
# zod 0.8.0, zod.eval.detection.evaluate_nuscenes_style: labels of a frame scored against themselves, in the vehicle's frame.
#
# Guess: boxes are scored in the LiDAR's frame, in which ZOD's labels are; or in any one frame, since distances and turns are the same.
# Seen: only in the vehicle's, and which frame it is is told by the mean of the labels' centres: if y is its largest number the error says
# "lidar", if z is, "camera". Right labels are refused where cars stand beside more than ahead, or as many behind as ahead.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv env && env/bin/pip install --quiet zod==0.8.0 'dataclass-wizard<0.30'
env/bin/python - <<'PYTHON'
from zod.eval.detection import DetectionBox, EvalBoxes, evaluate_nuscenes_style


def boxes(centres, score):
    found = EvalBoxes()
    size, turn = (1.8, 4.5, 1.5), (1.0, 0.0, 0.0, 0.0)
    cars = [DetectionBox("000001", c, size, turn, detection_name="Vehicle_Car", detection_score=score) for c in centres]
    found.add_boxes("000001", cars)
    return found


def scored(*centres, **how):
    try:
        return evaluate_nuscenes_style(boxes(centres, -1.0), boxes(centres, 0.9), **how)["mAP"]
    except ValueError as error:
        return str(error)


ahead, beside = [(20.0, 3.0, 0.8), (40.0, -3.0, 0.8)], [(8.0, 12.0, 0.8), (10.0, 25.0, 0.8)]
around, above = [(20.0, 3.0, 0.8), (-30.0, 2.0, 0.8)], [(1.0, -5.0, 3.0)]
for name, cars in (("ahead", ahead), ("beside", beside), ("around", around), ("above", above)):
    print(name, scored(*cars))
assert abs(scored(*ahead) - 1.0) < 1e-9
assert "lidar coordinate system" in scored(*beside) and "lidar coordinate system" in scored(*around)
assert "camera coordinate system" in scored(*above)
assert abs(scored(*beside, verify_coordinate_system=False) - 1.0) < 1e-9
PYTHON
