"""What FiftyOne makes of its samples, without its database, and writes again: FILE OUT."""

import json
import sys
from pathlib import Path

import fiftyone as fo

FACES = [[5, 4, 6, 7], [1, 0, 2, 3]]
"""Of fgrecon's corners: front and rear."""
samples = [fo.Sample.from_dict(one) for one in json.loads(Path(sys.argv[1]).read_text())["samples"]]
found = {}
for sample in samples:
    width, height = sample.metadata.width, sample.metadata.height

    def scaled(points, width=width, height=height):
        return [[u * width, v * height] for u, v in points]

    vehicles = {}
    for one in sample.detections.detections:
        x, y, w, h = one.bounding_box
        box = [x * width, y * height, (x + w) * width, (y + h) * height]
        vehicles[one.index] = {"kind": one.label, "box": box, "score": one.confidence}
    for one in sample.keypoints.keypoints:
        hidden = [value < 0.5 for value in one.confidence]
        vehicles[one.index] |= {"points": dict(zip(one.names, scaled(one.points))), "hidden": hidden}
    for one in sample.cuboids.polylines:
        corners = {}
        for face, points in zip(FACES, one.points):
            corners |= dict(zip(face, scaled(points)))
        vehicles[one.index]["pixels"] = [corners[n] for n in range(8)]
        named = [corners[n] for face in FACES for n in face]
        theirs = fo.Polyline.from_cuboid(named, frame_size=(width, height)).points
        assert len(theirs) == len(one.points)
        for ours, other in zip(one.points, theirs):
            a, b = sorted(ours), sorted(other)
            assert max(abs(p - q) for m, n in zip(a, b) for p, q in zip(m, n)) < 1e-12
    found[Path(sample.filepath).name] = list(vehicles.values())
Path(sys.argv[2]).write_text(json.dumps({"samples": [one.to_dict() for one in samples]}, default=str))
json.dump(found, sys.stdout)
