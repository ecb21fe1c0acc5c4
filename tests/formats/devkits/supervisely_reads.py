"""What Supervisely reads of an annotation, and writes again: FILE OUT KIND,... < names of the keypoints."""

import json
import sys
from pathlib import Path

import supervisely as sly
from supervisely.geometry.graph import KeypointsTemplate

template = KeypointsTemplate()
for name in json.load(sys.stdin):
    template.add_point(label=name, row=0, col=0)
kinds = sys.argv[3].split(",")
graphs = [sly.ObjClass(kind, sly.GraphNodes, geometry_config=template) for kind in kinds]
meta = sly.ProjectMeta([*graphs, *(sly.ObjClass(f"{kind} box", sly.Rectangle) for kind in kinds)])
annotation = sly.Annotation.load_json_file(sys.argv[1], meta)
vehicles = {}
for label in annotation.labels:
    about, shape = vehicles.setdefault(label.binding_key, {}), label.geometry
    if isinstance(shape, sly.Rectangle):
        about["box"] = [shape.left, shape.top, shape.right, shape.bottom]
        assert label.obj_class.name == f"{about['kind']} box" if "kind" in about else True
    else:
        about["points"] = {name: [n.location.col, n.location.row] for name, n in shape.nodes.items()}
        about["kind"] = label.obj_class.name
Path(sys.argv[2]).write_text(json.dumps(annotation.to_json()))
json.dump({"": list(vehicles.values())}, sys.stdout)
