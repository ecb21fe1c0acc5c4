"""What Supervisely reads of an annotation: FILE KIND,... < names of the keypoints."""

import json
import sys

import supervisely as sly
from supervisely.geometry.graph import KeypointsTemplate

template = KeypointsTemplate()
for name in json.load(sys.stdin):
    template.add_point(label=name, row=0, col=0)
kinds = sys.argv[2].split(",")
graphs = [sly.ObjClass(kind, sly.GraphNodes, geometry_config=template) for kind in kinds]
meta = sly.ProjectMeta([*graphs, *(sly.ObjClass(f"{kind} box", sly.Rectangle) for kind in kinds)])
annotation = sly.Annotation.load_json_file(sys.argv[1], meta)
found = {"size": annotation.img_size, "boxes": [], "points": []}
for label in annotation.labels:
    about = {"kind": label.obj_class.name, "instance": label.binding_key}
    if isinstance(label.geometry, sly.Rectangle):
        box = label.geometry
        found["boxes"].append({**about, "box": [box.left, box.top, box.right, box.bottom]})
    else:
        nodes = {name: [n.location.col, n.location.row] for name, n in label.geometry.nodes.items()}
        found["points"].append({**about, "points": nodes})
json.dump(found, sys.stdout)
