"""What datumaro reads of a folder, and writes again in its own format: FOLDER FORMAT OUT."""

import json
import sys

import datumaro
from datumaro.components.annotation import AnnotationType

RING = [7, 6, 2, 3, 5, 4, 0, 1]
"""Of fgrecon's corners: rear before front, bottom before top, right before left."""
dataset = datumaro.Dataset.import_from(sys.argv[1], sys.argv[2])
labels = dataset.categories()[AnnotationType.label]
names = dataset.categories().get(AnnotationType.points)
found, loose = {}, {}
for item in dataset:
    vehicles = found.setdefault(item.id, {})
    for one in item.annotations:
        if one.group == 0:  # a point of CVAT's skeletons, which it takes apart: the vehicle's box follows
            loose[labels[one.label].name] = [float(value) for value in one.points]
            continue
        about, kind, label = vehicles.setdefault(one.group, {"points": {}}), type(one).__name__, labels[one.label].name
        if kind == "Bbox":
            about["points"], loose = loose or about["points"], {}
            about |= {"kind": label, "box": [one.x, one.y, one.x + one.w, one.y + one.h], "told": one.attributes}
        elif kind == "Points":
            pairs = [[float(u), float(v)] for u, v in zip(one.points[::2], one.points[1::2])]
            about["points"] |= dict(zip(names.items[one.label].labels, pairs))
            about.setdefault("hidden", []).extend(int(value) == 1 for value in one.visibility)
        elif kind == "Cuboid2D":
            about["pixels"] = [[float(value) for value in one.points[RING.index(n)]] for n in range(8)]
if len(sys.argv) > 3:
    dataset.export(sys.argv[3], "datumaro")
json.dump({name: list(vehicles.values()) for name, vehicles in found.items()}, sys.stdout)
