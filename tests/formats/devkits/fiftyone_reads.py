"""What FiftyOne makes of its samples, without its database: FILE < the cuboid's corners (pixels) in its order."""

import json
import sys
from pathlib import Path

import fiftyone as fo

given = json.load(sys.stdin)
samples = [fo.Sample.from_dict(one) for one in json.loads(Path(sys.argv[1]).read_text())["samples"]]
found = []
for sample in samples:
    size = sample.metadata.width, sample.metadata.height
    boxes = [[one.label, one.index, one.confidence, one.bounding_box] for one in sample.detections.detections]
    points = [[one.label, one.index, one.points, one.confidence, one.names] for one in sample.keypoints.keypoints]
    cuboids = [one.points for one in sample.cuboids.polylines]
    theirs = [fo.Polyline.from_cuboid(one, frame_size=size).points for one in given]
    again = fo.Sample.from_dict(sample.to_dict())
    assert again.keypoints.keypoints[0].points == sample.keypoints.keypoints[0].points
    found.append({"boxes": boxes, "points": points, "cuboids": cuboids, "theirs": theirs})
json.dump(found, sys.stdout)
