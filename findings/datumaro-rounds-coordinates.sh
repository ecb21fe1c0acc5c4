#!/usr/bin/env bash
# datumaro 1.13.12, annotations: coordinates are rounded to two decimals when an annotation is made, and kept as 32 bits.
#
# Guess: COCO's keypoints and boxes that are read and written again have the digits that they had.
# Seen: 10.126 becomes 10.130000114440918: another number with more digits. A data set that is only converted has moved, and
# files that should be equal differ in every line.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv env && env/bin/pip install --quiet datumaro==1.13.12
env/bin/python - <<'PYTHON'
from datumaro.components.annotation import Bbox, Points

point, box = Points([10.126, 20.5]).points, Bbox(10.126, 20.5, 30.333, 40.0).points
print("keypoint", point, "box", box)
assert point[0] == 10.130000114440918 and abs(box[2] - 40.46) < 1e-5
PYTHON
