#!/usr/bin/env bash
# datumaro 1.13.12, import of CVAT's XML: cuboids are left out, and the points of a skeleton become shapes of their own.
#
# Guess: of an image with a skeleton of two points, a cuboid and a box there are three annotations, or a warning.
# Seen: the cuboid is gone, without a word; the skeleton is two loose `Points`, and that they were one car is lost.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv env && env/bin/pip install --quiet datumaro==1.13.12
env/bin/python - <<'PYTHON'
import os

import cv2
import datumaro
import numpy as np

os.makedirs("images")
cv2.imwrite("images/a.jpg", np.zeros((100, 200, 3), np.uint8))
point = '<points label="%s" outside="0" occluded="0" points="%s"></points>'
points = point % ("left", "10.50,20.25") + point % ("right", "30.50,40.25")
corners = " ".join(f'{n}="{v}"' for n, v in zip(("xtl1", "ytl1", "xbl1", "ybl1", "xtr1", "ytr1", "xbr1", "ybr1", "xtl2", "ytl2", "xbl2", "ybl2", "xtr2", "ytr2", "xbr2", "ybr2"), (1, 2, 1, 30, 40, 3, 40, 33, 60, 4, 60, 30, 20, 5, 20, 28)))
names = "".join(f"<label><name>{n}</name><attributes></attributes></label>" for n in ("car", "left", "right"))
image = f'<skeleton label="car" z_order="0">{points}</skeleton><cuboid label="car" occluded="0" {corners} z_order="0"></cuboid><box label="car" occluded="0" xtl="10" ytl="2" xbr="60" ybr="50" z_order="0"></box>'
open("a.xml", "w").write(f'<?xml version="1.0"?><annotations><version>1.1</version><meta><task><labels>{names}</labels></task></meta><image id="0" name="a.jpg" width="200" height="100">{image}</image></annotations>')
(item,) = datumaro.Dataset.import_from(".", "cvat")
found = [(type(a).__name__, a.group) for a in item.annotations]
print(found)
assert sorted(name for name, _ in found) == ["Bbox", "Points", "Points"] and {group for _, group in found} == {0}
PYTHON
