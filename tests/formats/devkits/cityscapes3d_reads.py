"""What cityscapesscripts makes of its folder: run in its own environment, FOLDER."""

import json
import sys
from pathlib import Path

import numpy as np
from cityscapesscripts.helpers.annotation import Annotation, CsObjectType
from cityscapesscripts.helpers.box3dImageTransform import CRS_S, CRS_V, Box3dImageTransform

ORDER = ["BRB", "BLB", "BRT", "BLT", "FRB", "FLB", "FRT", "FLT"]
found = {"corners": {}, "images": {}}
for file in sorted(Path(sys.argv[1]).glob("gtBbox3d/*/*/*.json")):
    stem, labels = file.name.removesuffix("_gtBbox3d.json"), Annotation(CsObjectType.BBOX3D)
    labels.fromJsonFile(str(file))
    seen = {}
    for number, item in enumerate(labels.objects):
        box = Box3dImageTransform(labels.camera)
        box.initialize_box_from_annotation(item, coordinate_system=CRS_V)
        points = np.array([box.get_vertices(CRS_S)[name] for name in ORDER])
        pixels = np.array([box.get_vertices_2d()[name] for name in ORDER])
        key = f"{stem}-{number}"
        found["corners"][key] = [np.asarray(box.get_vertices(CRS_V)[name]).tolist() for name in ORDER]
        seen[key] = {"corners": points.tolist(), "pixels": np.where(points[:, 2:] > 0.1, pixels, 0.0).tolist()}
    found["images"][stem] = seen
json.dump(found, sys.stdout)
