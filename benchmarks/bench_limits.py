"""Where it begins to fail: `python -m benchmarks.bench_limits DRIVE ... [--weights FILE] [--every 2] [--json FILE]`.

Frames of labelled drives are made worse on purpose (`benchmarks.weather`): night, rain, haze, blur, fewer pixels, a
lens that bends lines. Of each: how many of the labelled cars the detector finds (by more than half), and in their
labelled boxes how many are within 5 degrees, flipped, and how far off.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from benchmarks.weather import CHANGES, View
from fgrecon.calibration.labelled_boxes import FLIPPED_DEGREES, match_detections, outcome, wanted
from fgrecon.calibration.labelled_frames import Setup, reconstruct_boxes
from fgrecon.core.camera import Ground
from fgrecon.core.metrics import FAILURE_DEGREES
from fgrecon.core.options import Options
from fgrecon.core.size_prior import size_prior
from fgrecon.io.catalogue import load_prior
from fgrecon.io.files import write_text
from fgrecon.io.images import read_image
from fgrecon.io.kitti_files import DriveFrame, Objects, read_drive
from fgrecon.io.track_file import GroundTruth
from fgrecon.perception.keypoints.detect import KeypointCascade
from fgrecon.perception.vehicles import NanodetVehicleDetector

Row = tuple[float, float, float]
"""Whether a car was found, and its errors in degrees and metres."""


def rows(frame: DriveFrame, name: str, setup: Setup, detector: NanodetVehicleDetector) -> Iterator[Row]:
    """What becomes of the labelled cars of a frame."""
    labels, objects = wanted(frame), frame.objects
    labels = labels[np.array([objects.kind[i] == "Car" for i in labels], dtype=bool)]
    if not len(labels):
        return
    image = read_image(frame.image)
    camera, rng = frame.calibration.camera.with_size_of(image), np.random.default_rng(frame.number)
    view = CHANGES[name](View(image, objects.box[labels], camera), rng)
    labelled = replace(objects.take(labels), box=view.boxes)
    found = detector(view.image)
    boxes = Objects.detections(["Car"] * len(found), found.boxes, found.scores)
    seen = match_detections(labelled, boxes, 0.5) >= 0
    offset = frame.calibration.label_offset
    for i, one in enumerate(reconstruct_boxes(view.image, view.camera, list(view.boxes), setup)):
        if one.result is None:
            yield float(seen[i]), FAILURE_DEGREES, np.inf
            continue
        truth = GroundTruth(labelled.location[i], float(labelled.rotation_y[i]))
        off = outcome(one.result, truth, labelled.size[i], offset)
        yield float(seen[i]), off.degrees, off.metres


def table(found: dict[str, Sequence[Row]]) -> str:
    """Markdown."""
    lines = ["| picture | cars | detected % | within 5° % | flipped % | median m |", "|---|---:|---:|---:|---:|---:|"]
    for name, some in found.items():
        seen, degrees, metres = np.array(some).T
        within, turned = 100.0 * np.mean(degrees <= 5.0), 100.0 * np.mean(degrees > FLIPPED_DEGREES)
        numbers = f"{100.0 * np.mean(seen):.0f} | {within:.0f} | {turned:.1f} | {np.median(metres):.2f}"
        lines.append(f"| {name} | {len(some)} | {numbers} |")
    return "\n".join(lines)


def main() -> int:
    """Look at every frame in every way."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("drives", type=Path, nargs="+")
    parser.add_argument("--weights", help="keypoint network; `photographs` has learnt from no image of KITTI")
    parser.add_argument("--every", type=int, default=2, help="every so many frames with a labelled car")
    parser.add_argument("--json", type=Path, help="file for the errors of every car")
    given = parser.parse_args()
    cv2.setNumThreads(1)
    setup = Setup(
        detector=KeypointCascade(given.weights),
        prior=load_prior("car14"),
        ground=Ground.level(1.65),
        size_prior=size_prior("kitti"),
        options=Options(box="cuboid", keep_history=False),
    )
    detector = NanodetVehicleDetector()
    frames = [f for folder in given.drives for f in read_drive(folder.absolute()).frames if len(wanted(f))]
    found: dict[str, Sequence[Row]] = {}
    for name in CHANGES:
        found[name] = [row for frame in frames[:: given.every] for row in rows(frame, name, setup, detector)]
        print(f"{name}: {len(found[name])} cars", file=sys.stderr)
    print(table(found))
    if given.json is not None:
        write_text(given.json, json.dumps(found) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
