"""Scalabel's file of a vehicle: FILE < JSON of its box and its points by name."""

import json
import sys

from scalabel.label.io import save
from scalabel.label.typing import Box2D, Config, Dataset, Frame, Graph, Label, Node

given = json.load(sys.stdin)
box = Box2D(**dict(zip(("x1", "y1", "x2", "y2"), given["box"])))
nodes = [Node(id=n, category=n, location=uv, visibility="V") for n, uv in given["points"].items()]
graph = Graph(nodes=nodes, edges=[])
label = Label(id="7", category="car", box2d=box, box3d=None, poly2d=None, rle=None, graph=graph)
config = Config(categories=[], imageSize=None, attributes=None, poseSigmas=None)
save(sys.argv[1], Dataset(frames=[Frame(name="street.png", url=None, labels=[label])], groups=None, config=config))
