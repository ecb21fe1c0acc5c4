"""vcd's file of a vehicle in frame 3: FILE < JSON of its box and its points by name."""

import json
import sys
from pathlib import Path

from vcd import core, types

given = json.load(sys.stdin)
labels = core.OpenLABEL()
labels.add_stream("camera", "a/street.png", "", core.StreamType.camera)
car = labels.add_object("7", "car", frame_value=3)
x1, y1, x2, y2 = given["box"]
labels.add_object_data(car, types.bbox("shape", ((x1 + x2) / 2, (y1 + y2) / 2, x2 - x1, y2 - y1)), 3)
for name, uv in given["points"].items():
    labels.add_object_data(car, types.point2d(name, tuple(uv)), 3)
Path(sys.argv[1]).write_text(labels.stringify(pretty=False))
