#!/usr/bin/env bash
# supervisely 6.74.51, Annotation.from_json: a graph of keypoints of which one lies outside the image, as of a vehicle that its edge cuts off.
#
# Guess: what lies outside is kept as it is (FiftyOne, labelme, datumaro keep it), or that one node is left out.
# Seen: the whole graph is gone, without a word: GraphNodes.crop gives it back only if all nodes are inside, and every annotation crops
# its labels when it is made. A rectangle that reaches outside is cut at the edge. A disabled node counts as well.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv env && env/bin/pip install --quiet supervisely==6.74.51
env/bin/python - <<'PYTHON'
import supervisely as sly
from supervisely.geometry.graph import KeypointsTemplate

template = KeypointsTemplate()
for name in ("front", "back"):
    template.add_point(label=name, row=0, col=0)
classes = [sly.ObjClass("car", sly.GraphNodes, geometry_config=template), sly.ObjClass("box", sly.Rectangle)]
meta = sly.ProjectMeta(classes)


def read(back, **more):
    nodes = {"front": {"loc": [5, 6]}, "back": {"loc": back, **more}}
    graph = {"classTitle": "car", "geometryType": "graph", "shape": "graph", "tags": [], "nodes": nodes}
    box = {"classTitle": "box", "geometryType": "rectangle", "shape": "rectangle", "tags": []}
    box["points"] = {"exterior": [[-10, 2], [30, 20]], "interior": []}
    about = {"description": "", "size": {"height": 40, "width": 50}, "tags": [], "objects": [box, graph]}
    return {label.obj_class.name: label.geometry for label in sly.Annotation.from_json(about, meta).labels}


print("both inside:", sorted(read([40, 6])), "one outside:", sorted(read([-1, 6])))
assert sorted(read([40, 6])) == ["box", "car"]
assert sorted(read([-1, 6])) == sorted(read([-1, 6], disabled=True)) == ["box"]
assert read([-1, 6])["box"].left == 0
PYTHON
