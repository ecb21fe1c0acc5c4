#!/usr/bin/env bash
# faster-coco-eval 1.8.0, COCOeval_faster(..., iouType="bbox"): the named results, stats_as_dict.
#
# Guess: "AR_all" is the average recall of all objects, as "AP_all" beside it is their precision, and as it is for iouType="keypoints".
# Seen: it is the recall with one detection in an image: with five cars in each image, all found, "AR_all" is 0.2 while "AP_all", "AR_50" and
# "AR_medium" are 1. The recall of all is called "AR_third" (100 detections; "AR_second" is 10). With other limits than COCO's the keys are
# AR_1, AR_5, ...; a comment in the code says that the names stay as they were. Numbers and order are pycocotools'.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv env && env/bin/pip install --quiet faster-coco-eval==1.8.0 numpy==2.3.5
env/bin/python - <<'PYTHON'
from faster_coco_eval import COCO, COCOeval_faster

boxes = [[100 * column, 0, 50, 50] for column in range(5)]
labels = [{"image_id": image, "category_id": 1, "bbox": box, "area": 2500, "iscrowd": 0} for image in range(1, 21) for box in boxes]
truth = COCO()
truth.dataset = {
    "info": {},
    "images": [{"id": image, "width": 600, "height": 100} for image in range(1, 21)],
    "categories": [{"id": 1, "name": "car"}],
    "annotations": [label | {"id": index} for index, label in enumerate(labels, 1)],
}
truth.createIndex()
results = [{key: label[key] for key in ("image_id", "category_id", "bbox")} | {"score": 0.9} for label in labels]


def told(limits):
    """The named results with these numbers of detections in an image."""
    evaluation = COCOeval_faster(truth, truth.loadRes(results), "bbox")
    evaluation.params.maxDets = limits
    evaluation.evaluate()
    evaluation.accumulate()
    evaluation.summarize()
    return {name: round(float(value), 3) for name, value in evaluation.stats_as_dict.items()}


usual, other = told([1, 10, 100]), told([1, 5, 100])
print("limits 1, 10, 100:", usual)
print("limits 1, 5, 100:", other)
assert usual["AP_all"] == usual["AR_50"] == usual["AR_medium"] == usual["AR_third"] == 1 and usual["AR_all"] == 0.2
assert "AR_all" not in other and other["AR_1"] == 0.2 and other["AR_5"] == 1
PYTHON
