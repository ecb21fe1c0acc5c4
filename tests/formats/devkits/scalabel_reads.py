"""What scalabel reads of a file of frames, and writes again: FILE OUT. Corners of boxes as its own viewer has them."""

import json
import sys

from scalabel.label.io import load, save
from scalabel.vis.geometry import Label3d

dataset = load(sys.argv[1], 1)
found = {}
for frame in dataset.frames:
    found[frame.name] = [
        {
            "name": one.id,
            "kind": one.category,
            "score": one.score,
            "box": [one.box2d.x1, one.box2d.y1, one.box2d.x2, one.box2d.y2],
            "corners": [vertex.tolist() for vertex in Label3d.from_box3d(one.box3d).vertices],
            "points": {node.category: node.location for node in one.graph.nodes},
            "hidden": [node.visibility == "N" for node in one.graph.nodes],
        }
        for one in frame.labels
    ]
save(sys.argv[2], dataset)
json.dump(found, sys.stdout)
