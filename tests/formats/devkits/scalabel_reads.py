"""What scalabel reads of a file of frames: FILE. Corners of the boxes as its own viewer has them, and the points."""

import json
import sys

from scalabel.label.io import load
from scalabel.vis.geometry import Label3d

frames = load(sys.argv[1], 1).frames
found = [
    {
        "image": frame.name,
        "focal": frame.intrinsics.focal,
        "boxes": [[one.box2d.x1, one.box2d.y1, one.box2d.x2, one.box2d.y2] for one in frame.labels],
        "corners": [[v.tolist() for v in Label3d.from_box3d(one.box3d).vertices] for one in frame.labels],
        "points": [{node.category: node.location for node in one.graph.nodes} for one in frame.labels],
    }
    for frame in frames
]
json.dump(found, sys.stdout)
