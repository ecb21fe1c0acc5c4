"""Supervisely's file of a vehicle: FILE < JSON of its box and its points by name."""

import json
import sys
from pathlib import Path

import supervisely as sly
from supervisely.geometry.graph import KeypointsTemplate

given = json.load(sys.stdin)
template = KeypointsTemplate()
for name in given["points"]:
    template.add_point(label=name, row=0, col=0)
graph = sly.GraphNodes([sly.Node(label=name, row=v, col=u) for name, (u, v) in given["points"].items()])
x1, y1, x2, y2 = given["box"]
points = sly.Label(graph, sly.ObjClass("car", sly.GraphNodes, geometry_config=template), binding_key="k")
box = sly.Label(sly.Rectangle(y1, x1, y2, x2), sly.ObjClass("carbox", sly.Rectangle), binding_key="k")
Path(sys.argv[1]).write_text(json.dumps(sly.Annotation((375, 1242), [points, box]).to_json()))
