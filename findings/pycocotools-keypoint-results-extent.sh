#!/usr/bin/env bash
# pycocotools 2.0.11, COCO.loadRes: a keypoint result without a box gets one, and its area, from ALL its keypoints. Those
# that were not found are (0, 0, 0) in COCO's format, and are counted as points at the image's corner.
#
# Guess: box and area of a car of which 4 of 14 points were found are the extent of these 4 (20 x 20 = 400).
# Seen: the box reaches from the corner of the image, 520 x 320 = 166,400. COCOeval files unmatched results by this area,
# so that a small car's false alarm counts among the large ones. Results with a "bbox" keep theirs.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv env && env/bin/pip install --quiet pycocotools==2.0.11 numpy==2.3.5
cat > check.py <<'PYTHON'
import contextlib, io, json
from pycocotools.coco import COCO

found = [500, 300, 2, 520, 300, 2, 520, 320, 2, 500, 320, 2]
keypoints = [0, 0, 0] * 10 + found
label = {"id": 1, "image_id": 1, "category_id": 1, "keypoints": keypoints, "num_keypoints": 4, "bbox": [500, 300, 20, 20],
         "area": 400, "iscrowd": 0}
category = {"id": 1, "name": "car", "keypoints": [f"p{i}" for i in range(14)], "skeleton": []}
json.dump({"info": {}, "images": [{"id": 1, "width": 640, "height": 480}], "categories": [category], "annotations": [label]},
          open("labels.json", "w"))
result = {"image_id": 1, "category_id": 1, "keypoints": keypoints, "score": 0.9}
with contextlib.redirect_stdout(io.StringIO()):
    labels = COCO("labels.json")
    without = labels.loadRes([dict(result)]).anns[1]
    with_box = labels.loadRes([{**result, "bbox": [500, 300, 20, 20]}]).anns[1]
print("without a box:", [int(x) for x in without["bbox"]], int(without["area"]), "with one:", with_box["area"])
assert [int(x) for x in without["bbox"]] == [0, 0, 520, 320] and int(without["area"]) == 166400
assert with_box["area"] == 400
PYTHON
env/bin/python check.py
