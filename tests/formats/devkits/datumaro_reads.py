"""What datumaro reads of a folder with CVAT's XML: FOLDER. Boxes, and points one by one."""

import json
import sys

import datumaro

(item,) = datumaro.Dataset.import_from(sys.argv[1], "cvat")
found = {"boxes": [], "points": []}
for one in item.annotations:
    kind = type(one).__name__
    if kind == "Bbox":
        found["boxes"].append([one.x, one.y, one.x + one.w, one.y + one.h])
    elif kind == "Points":
        found["points"].append([float(value) for value in one.points])
json.dump(found, sys.stdout)
