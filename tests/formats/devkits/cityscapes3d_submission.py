"""What cityscapesscripts reads of an image's boxes: FILE."""

import json
import sys
from pathlib import Path

import numpy as np
from cityscapesscripts.helpers.annotation import CsBbox3d
from cityscapesscripts.helpers.box3dImageTransform import CRS_V, Box3dImageTransform, Camera

ORDER = ["BRB", "BLB", "BRT", "BLT", "FRB", "FLB", "FRT", "FLT"]
found = {"corners": [], "score": []}
for item in json.loads(Path(sys.argv[1]).read_text())["objects"]:
    label = CsBbox3d()
    label.fromJsonText(item)
    box = Box3dImageTransform(Camera(1000.0, 1000.0, 800.0, 450.0, np.eye(4)[:3].tolist()))
    box.initialize_box_from_annotation(label, coordinate_system=CRS_V)
    found["corners"].append([box.get_vertices(CRS_V)[name].tolist() for name in ORDER])
    found["score"].append(label.score)
json.dump(found, sys.stdout)
