"""What datumaro reads of a folder: FOLDER FORMAT. Boxes, and points one by one."""

import json
import sys

import datumaro

(item,) = datumaro.Dataset.import_from(sys.argv[1], sys.argv[2])
found = {"boxes": [], "points": [], "cuboids": [], "groups": []}
for one in item.annotations:
    kind = type(one).__name__
    found["groups"].append(one.group)
    if kind == "Bbox":
        found["boxes"].append([one.x, one.y, one.x + one.w, one.y + one.h])
    elif kind == "Points":
        found["points"].append([float(value) for value in one.points])
    elif kind == "Cuboid2D":
        found["cuboids"].append([[float(value) for value in point] for point in one.points])
json.dump(found, sys.stdout)
