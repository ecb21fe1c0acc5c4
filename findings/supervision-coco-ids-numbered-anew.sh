#!/usr/bin/env bash
# supervision 0.31.2, DetectionDataset.from_coco and as_coco: ids of images and categories are not kept.
#
# Guess: COCO's annotations that are read and written again have the ids that they had.
# Seen: image 7 becomes 1 and category 8 ("truck") becomes 2, by their places. Results beside the new file no longer belong to the
# old one: COCOeval of the two compares cars with lorries, or nothing, without a word.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv env && env/bin/pip install --quiet supervision==0.31.2 opencv-python-headless==4.12.0.88
env/bin/python - <<'PYTHON'
import json

import cv2
import numpy as np
import supervision as sv

cv2.imwrite("a.jpg", np.zeros((100, 200, 3), np.uint8))
label = {"id": 1, "image_id": 7, "category_id": 8, "bbox": [10.25, 20.5, 30.125, 40], "area": 1205, "iscrowd": 0, "segmentation": []}
kinds = [{"id": 3, "name": "car", "supercategory": "vehicle"}, {"id": 8, "name": "truck", "supercategory": "vehicle"}]
images = [{"id": 7, "file_name": "a.jpg", "width": 200, "height": 100}]
json.dump({"images": images, "categories": kinds, "annotations": [label]}, open("labels.json", "w"))
sv.DetectionDataset.from_coco(".", "labels.json").as_coco(annotations_path="again.json")
again = json.load(open("again.json"))
print({c["name"]: c["id"] for c in again["categories"]}, again["annotations"][0])
assert again["annotations"][0]["category_id"] == 2 and again["annotations"][0]["image_id"] == 1
assert again["annotations"][0]["bbox"] == label["bbox"]
PYTHON
