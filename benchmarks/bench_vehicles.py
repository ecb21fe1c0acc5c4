"""How many cars of KITTI's images the detector finds, how many of its boxes are none, and how long it takes.

Run from the repository root:
    python -m benchmarks.bench_vehicles --images training/image_2 --labels training/label_2 [--threads 1]
Prints recall by regime, precision and the time per image. A box counts for a label that it overlaps by more than 0.5
(0.7), each label for one box. Precision is that of boxes of at least 25 pixels' height; vans are no mistakes, and boxes
in areas that were not labelled are left out.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import cv2
import numpy as np

from fgrecon.evaluation.kitti_devkit import REGIMES, match_detections, regime_members
from fgrecon.evaluation.kitti_overlap import box_overlap
from fgrecon.io.images import read_image
from fgrecon.io.kitti_files import Objects, read_labels
from fgrecon.perception.vehicles import YoloVehicleDetector


def recall(labels: Objects, found: Objects, least: float) -> np.ndarray:
    """(3, 2) cars that are found and cars that there are, by regime."""
    counts = []
    for regime in REGIMES:
        cars = labels.take(regime_members(labels, regime) & np.array([kind == "Car" for kind in labels.kind]))
        counts.append([(match_detections(cars, found, least) >= 0).sum(), len(cars)])
    return np.array(counts)


def precision(labels: Objects, found: Objects, least: float) -> np.ndarray:
    """(2,) boxes that are right and boxes that are judged."""
    tall = found.take(found.box[:, 3] - found.box[:, 1] >= REGIMES[-1].height)
    cars = labels.take(np.array([kind in ("Car", "Van") for kind in labels.kind]))
    matched = match_detections(cars, tall, least)
    right = np.zeros(len(tall), dtype=bool)
    right[matched[matched >= 0]] = True
    unlabelled = labels.take(np.array([kind == "DontCare" for kind in labels.kind]))
    ignored = ~right & (box_overlap(tall.box, unlabelled.box, of_first=True) > 0.5).any(axis=1)
    return np.array([right.sum(), (~ignored).sum()])


def main() -> None:
    """Measure."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--images", type=Path, required=True)
    parser.add_argument("--labels", type=Path, required=True)
    parser.add_argument("--threads", type=int, default=1)
    arguments = parser.parse_args()
    cv2.setNumThreads(arguments.threads)
    files = sorted(arguments.images.glob("*.png"))
    labels, _ = read_labels(arguments.labels, [file.stem for file in files])
    detector, found, times = YoloVehicleDetector(), {}, []
    for file in files:
        image = read_image(file)
        started = time.perf_counter()
        cars = detector(image)
        times.append(time.perf_counter() - started)
        found[file.stem] = Objects.detections(["Car"] * len(cars), cars.boxes, cars.scores)
    for least in (0.5, 0.7):
        cars = sum(recall(labels[name], found[name], least) for name in found)
        right, judged = sum(precision(labels[name], found[name], least) for name in found)
        regimes = ", ".join(
            f"{regime.name} {hits} of {count}" for regime, (hits, count) in zip(REGIMES, cars, strict=True)
        )
        print(f"overlap {least}: {regimes}; {right} of {judged} boxes are right")
    print(f"{1e3 * min(times):.0f} ms per image (median {1e3 * np.median(times):.0f}), {arguments.threads} threads")


if __name__ == "__main__":
    main()
