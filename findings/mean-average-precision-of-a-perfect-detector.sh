#!/usr/bin/env bash
# mean-average-precision 2024.1.5.0, MetricBuilder: mAP "evaluated" as PASCAL VOC and COCO do, of detections that are the labels themselves.
#
# Guess: 1, and 1 as well where a label is `difficult` (VOC) or `crowd` (COCO), or a class has none: these are not asked for.
# Seen: a flagged label is counted among those to be found all the same: with a crowd beside one car it is 0.5 unless the crowd is found, with a
# difficult one it is 0.5, found or not. A class without labels counts as 0, where VOC and COCO leave it out: cars alone, of eight classes,
# have 0.125. pycocotools of the same has 1. Where classes are rare in a small test set, this is most of the number.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv env && env/bin/pip install --quiet mean-average-precision==2024.1.5.0 pycocotools==2.0.11 numpy==2.3.5 pandas==3.1.1
env/bin/python - <<'PYTHON'
import contextlib
import io

import numpy as np
from mean_average_precision import MetricBuilder
from pycocotools.coco import COCO
from pycocotools.cocoeval import COCOeval

boxes = np.array([[0, 0, 100, 100], [200, 0, 300, 100]], float)


def packaged(classes, difficult=0, crowd=0, found=2):
    """mAP of two labels of class 0, the second of them flagged, and of so many of them found."""
    labels = np.hstack([boxes, [[0, 0, 0], [0, difficult, crowd]]])
    detections = np.hstack([boxes, [[0, 0.9], [0, 0.8]]])[:found]
    metric = MetricBuilder.build_evaluation_metric("map_2d", async_mode=False, num_classes=classes)
    metric.add(detections, labels)
    return float(metric.value(iou_thresholds=0.5, recall_thresholds=np.arange(0, 1.01, 0.01), mpolicy="soft")["mAP"])


def coco(classes, crowd=0, found=2):
    """The same of pycocotools."""
    shapes = [{"image_id": 1, "category_id": 1, "bbox": [x, y, 100, 100], "area": 1e4} for x, y in boxes[:, :2]]
    truth = COCO()
    truth.dataset = {
        "images": [{"id": 1, "width": 400, "height": 200}],
        "categories": [{"id": index + 1, "name": str(index)} for index in range(classes)],
        "annotations": [shapes[0] | {"id": 1, "iscrowd": 0}, shapes[1] | {"id": 2, "iscrowd": crowd}],
    }
    results = [shape | {"score": score} for shape, score in zip(shapes, (0.9, 0.8))][:found]
    with contextlib.redirect_stdout(io.StringIO()):
        truth.createIndex()
        evaluation = COCOeval(truth, truth.loadRes(results), "bbox")
        evaluation.evaluate()
        evaluation.accumulate()
        evaluation.summarize()
    return evaluation.stats[1]


cases = {"plain": {}, "one crowd, found": {"crowd": 1}, "one crowd, not found": {"crowd": 1, "found": 1}}
rows = {name: (packaged(1, **case), coco(1, **case)) for name, case in cases.items()}
rows["eight classes, seven without labels"] = (packaged(8), coco(8))
rows["one difficult, found"] = (packaged(1, difficult=1), 1.0)  # VOC's development kit takes difficult labels off the number of positives
rows["one difficult, not found"] = (packaged(1, difficult=1, found=1), 1.0)
for name, (told, expected) in rows.items():
    print(f"{name}: mean-average-precision {told:.3f}, {'VOC' if 'difficult' in name else 'pycocotools'} {expected:.3f}")
    assert abs(expected - 1) < 1e-6
told = [told for told, _ in rows.values()]
assert np.allclose(told, [1, 1, 0.505, 0.125, 0.505, 0.505], atol=0.006)
PYTHON
