#!/usr/bin/env bash
# supervisely 6.74.51, ObjClass(name, AnyGeometry): a class whose objects may have any shape.
#
# Guess: an annotation with a rectangle and a graph of keypoints, both of class `car`, is read with a meta whose `car` is of any shape.
# Seen: the rectangle is; the graph fails with RuntimeError: KeyError('nodes'), since a graph is checked against the nodes of its
# class's `geometry_config`, which a class of any shape does not have. Keypoints need a class of shape graph of their own.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv env && env/bin/pip install --quiet supervisely==6.74.51
env/bin/python - <<'PYTHON'
import supervisely as sly
from supervisely.geometry.graph import KeypointsTemplate

box = {"classTitle": "car", "geometryType": "rectangle", "shape": "rectangle", "tags": []}
box["points"] = {"exterior": [[1, 2], [30, 20]], "interior": []}
graph = {"classTitle": "car", "geometryType": "graph", "shape": "graph", "tags": [], "nodes": {"wheel": {"loc": [5, 6]}}}


def read(objects, *classes):
    about = {"description": "", "size": {"height": 40, "width": 50}, "tags": [], "objects": objects}
    return sly.Annotation.from_json(about, sly.ProjectMeta(list(classes)))


anything = sly.ObjClass("car", sly.AnyGeometry)
print("a rectangle:", read([box], anything).labels[0].geometry.to_json()["points"]["exterior"])
try:
    read([box, graph], anything)
except RuntimeError as error:
    print("a graph:", str(error).strip())
    assert "KeyError('nodes')" in str(error)
else:
    raise SystemExit("a class of any shape takes graphs now")
template = KeypointsTemplate()
template.add_point(label="wheel", row=0, col=0)
found = read([graph], sly.ObjClass("car", sly.GraphNodes, geometry_config=template))
assert [(n.location.col, n.location.row) for n in found.labels[0].geometry.nodes.values()] == [(5, 6)]
PYTHON
