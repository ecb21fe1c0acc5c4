#!/usr/bin/env bash
# label-studio-sdk 2.1.2, export to Pascal VOC: the rotation of a rectangle is left out, not the rectangle around it written.
#
# Guess: a rectangle of 60 x 20 pixels that is turned by 90 degrees about its upper left corner, as Label Studio turns them, is
# written as the box of what it covers: x from 0 to 20, y from 20 to 80.
# Seen: x from 20 to 80, y from 20 to 40, as if it had never been turned.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv env && env/bin/pip install --quiet label-studio-sdk==2.1.2
env/bin/python - <<'PYTHON'
import glob
import json
import os
import re

from label_studio_sdk.converter import Converter

labels = '<View><Image name="image" value="$image"/><RectangleLabels name="label" toName="image"><Label value="car"/></RectangleLabels></View>'
value = {"x": 10, "y": 20, "width": 30, "height": 20, "rotation": 90, "rectanglelabels": ["car"]}
one = {"id": "r", "type": "rectanglelabels", "from_name": "label", "to_name": "image", "original_width": 200, "original_height": 100, "image_rotation": 0, "value": value}
json.dump([{"id": 1, "data": {"image": "a.jpg"}, "annotations": [{"id": 1, "completed_by": 1, "result": [one]}]}], open("tasks.json", "w"))
os.makedirs("out")
Converter(labels, ".", download_resources=False).convert_to_voc("tasks.json", "out", is_dir=False)
(file,) = glob.glob("out/**/*.xml", recursive=True)
box = {name: int(number) for name, number in re.findall(r"<(x...|y...)>(\d+)<", open(file).read())}
print(box)
assert box == {"xmin": 20, "ymin": 20, "xmax": 80, "ymax": 40}
PYTHON
