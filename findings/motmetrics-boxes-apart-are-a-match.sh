#!/usr/bin/env bash
# motmetrics 1.4.0, distances.iou_matrix(objects, found): max_iou, the "maximum tolerable overlap distance", "defaults to 0.5".
#
# Guess: as said: boxes that overlap by less than a half are no pair (NaN), unless max_iou says otherwise.
# Seen: it defaults to 1, and since only what is larger becomes NaN, boxes that do not touch at all may be paired: a tracker whose box is 80
# pixels beside the car all the time has MOTA 1, no miss, no false positive. With max_iou=0.5 it has -1. The name says
# overlap and means 1 - overlap: max_iou=0.7 asks for 0.3.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv env && env/bin/pip install --quiet motmetrics==1.4.0 numpy==1.26.4 pandas==2.2.3
env/bin/python - <<'PYTHON'
import motmetrics


def accuracy(**options):
    log = motmetrics.MOTAccumulator(auto_id=True)
    for frame in range(10):
        car, found = [[5 * frame, 50, 60, 40]], [[5 * frame + 80, 50, 60, 40]]
        log.update([1], [7], motmetrics.distances.iou_matrix(car, found, **options))
    return tuple(motmetrics.metrics.create().compute(log, metrics=["mota", "num_misses", "num_false_positives", "idf1"]).iloc[0])


plain, half = accuracy(), accuracy(max_iou=0.5)
print("MOTA, misses, false positives, IDF1:", plain, "with max_iou=0.5:", half)
assert "Defaults\n        to 0.5" in motmetrics.distances.iou_matrix.__doc__
assert plain == (1, 0, 0, 1) and half == (-1, 10, 10, 0)
PYTHON
