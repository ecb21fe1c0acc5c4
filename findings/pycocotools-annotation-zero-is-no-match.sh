#!/usr/bin/env bash
# pycocotools 2.0.11, COCOeval: two cars that are found exactly, of which the annotations are numbered 1, 2 or 0, 1.
#
# Guess: ids are names, as of images and categories, which may be 0: AP is 1 either way.
# Seen: 1 with ids from 1, 0.252 with ids from 0: the id of the annotation that a result matches is kept where 0 stands for none, so that
# a result on annotation 0 counts as a false one. Of a large data set one object is wrong and nobody sees it; of a small test, or one image
# at a time numbered anew, it is a good part of the score. Keypoints are scored by the same lines.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv env && env/bin/pip install --quiet pycocotools==2.0.11 numpy==2.3.5
env/bin/python - <<'PYTHON'
import contextlib
import io

from pycocotools.coco import COCO
from pycocotools.cocoeval import COCOeval


def precision(kind, first=1, image=1, category=1):
    cars = []
    for number in range(2):
        left = 100.0 * (number + 1)
        points = [left, 10.0, 2] * 9 + [left + 90, 90.0, 2] * 8
        car = {"id": first + number, "image_id": image, "category_id": category, "bbox": [left, 10.0, 90.0, 80.0], "area": 7200.0}
        cars.append(car | {"iscrowd": 0, "keypoints": points, "num_keypoints": 17})
    truth = COCO()
    truth.dataset = {"images": [{"id": image, "width": 640, "height": 480}], "annotations": cars, "categories": [{"id": category, "name": "car"}]}
    with contextlib.redirect_stdout(io.StringIO()):
        truth.createIndex()
        keys = ("image_id", "category_id", "bbox" if kind == "bbox" else "keypoints")
        found = truth.loadRes([{key: car[key] for key in keys} | {"score": 0.9} for car in cars])
        evaluation = COCOeval(truth, found, kind)
        evaluation.evaluate(), evaluation.accumulate(), evaluation.summarize()
    return round(float(evaluation.stats[0]), 3)


boxes = precision("bbox", first=1), precision("bbox", first=0)
points = precision("keypoints", first=1), precision("keypoints", first=0)
others = precision("bbox", image=0), precision("bbox", category=0)
print("AP of boxes with annotations from 1 and from 0:", boxes, "of keypoints:", points, "; with an image, a category 0:", others)
assert boxes == (1.0, 0.252) and points[0] == 1.0 and points[1] < 0.6 and others == (1.0, 1.0)
PYTHON
