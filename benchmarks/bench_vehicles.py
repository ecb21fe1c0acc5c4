"""How many cars the detector finds on KITTI's images and drives and on photographs, how many boxes are none, and time.

Run from the repository root:
    OMP_NUM_THREADS=2 python -m benchmarks.bench_vehicles --data DATA [--every 1] [--threads 2]
DATA holds kitti_object, kitti_video and posed_cars. A box counts for a label that it overlaps by more than 0.5 (0.7),
each label for one box. Precision is that of boxes of at least 25 pixels' height; vans are no mistakes, and boxes in
areas that were not labelled, or on cars that are drawn over, are left out. By size: the cars of the regime Hard and the
boxes by their height, pixels.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np

from fgrecon.calibration.labelled_boxes import box_overlap, match_detections
from fgrecon.io.images import read_image
from fgrecon.io.kitti_files import DriveFrame, Objects, read_images
from fgrecon.perception.vehicles import NanodetVehicleDetector, Vehicles
from fgrecon_research.evaluation.kitti_devkit import REGIMES, regime_members
from fgrecon_research.training.keypoints.posed_cars import read_posed_cars

OVERLAPS = (0.5, 0.7)
HEIGHTS = (25.0, 40.0, 80.0, np.inf)
PHOTOGRAPHS, ENLARGED = 300, 4.0


def recall(frame: DriveFrame, found: Objects, least: float) -> np.ndarray:
    """(6, 2) cars that are found and cars that there are, by regime, and by height those of the regime Hard."""
    labels = frame.objects.take(frame.usable & np.array([kind == "Car" for kind in frame.objects.kind], dtype=bool))
    groups = [regime_members(labels, regime) for regime in REGIMES]
    heights = labels.box[:, 3] - labels.box[:, 1]
    groups += [groups[-1] & (heights >= low) & (heights < high) for low, high in pairwise(HEIGHTS)]
    counts = []
    for group in groups:
        cars = labels.take(group)
        counts.append([(match_detections(cars, found, least) >= 0).sum(), len(cars)])
    return np.array(counts)


def precision(frame: DriveFrame, found: Objects, least: float) -> np.ndarray:
    """(4, 2) boxes that are right and boxes that are judged: of all, and by height."""
    labels, usable = frame.objects, frame.usable
    kinds = np.array(labels.kind)
    matched = match_detections(labels.take(usable & np.isin(kinds, ["Car", "Van"])), found, least)
    right = np.zeros(len(found), dtype=bool)
    right[matched[matched >= 0]] = True
    ignored = ~right & (box_overlap(found.box, labels.box[~usable | (kinds == "DontCare")], of_first=True) > 0.5).any(1)
    heights = found.box[:, 3] - found.box[:, 1]
    limits = [(HEIGHTS[0], HEIGHTS[-1]), *pairwise(HEIGHTS)]
    groups = [~ignored & (heights >= low) & (heights < high) for low, high in limits]
    return np.array([[(right & group).sum(), group.sum()] for group in groups])


def report(frames: list[tuple[DriveFrame, Vehicles]]) -> None:
    """Print a line for each overlap."""
    for least in OVERLAPS:
        cars, boxes = np.zeros((6, 2), dtype=int), np.zeros((4, 2), dtype=int)
        for frame, vehicles in frames:
            found = Objects.detections(["Car"] * len(vehicles), vehicles.boxes, vehicles.scores)
            cars += recall(frame, found, least)
            boxes += precision(frame, found, least)
        regimes = ", ".join(f"{regime.name} {part(count)}" for regime, count in zip(REGIMES, cars, strict=False))
        sizes = ", ".join(
            f"{low:.0f}-{high:.0f} {part(found)} | {part(right)}"
            for low, high, found, right in zip(HEIGHTS, HEIGHTS[1:], cars[3:], boxes[1:], strict=False)
        )
        print(f"  {least}: {regimes}; {part(boxes[0])} boxes right; found | right by size: {sizes}", flush=True)


def part(count: np.ndarray) -> str:
    """Such as `9 of 10`."""
    return f"{count[0]} of {count[1]}"


def photographs(data: Path, enlarged: float) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Photographs that a car fills, and its box (1, 4)."""
    cars = read_posed_cars(data / "posed_cars")
    for car in cars[:: len(cars) // PHOTOGRAPHS][:PHOTOGRAPHS]:
        image = read_image(car.image)
        larger = cv2.resize(image, None, fx=enlarged, fy=enlarged, interpolation=cv2.INTER_CUBIC)
        yield larger, (car.box[None] + 0.5) * enlarged - 0.5


def close_ups(detector: NanodetVehicleDetector, data: Path) -> None:
    """Print how many cars that fill an image are found."""
    for enlarged in (1.0, ENLARGED):
        best = np.array(
            [box_overlap(detector(i).boxes, box).max(initial=0.0) for i, box in photographs(data, enlarged)]
        )
        counts = ", ".join(f"{np.mean(best > least):.1%} above {least}" for least in OVERLAPS)
        print(f"  {len(best)} photographs, enlarged {enlarged:.0f} times: {counts}", flush=True)


def main() -> None:
    """Measure."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--every", type=int, default=1, help="one of so many frames of the drives")
    parser.add_argument("--threads", type=int, default=2)
    arguments = parser.parse_args()
    cv2.setNumThreads(arguments.threads)
    detector = NanodetVehicleDetector()
    images = read_images(arguments.data / "kitti_object" / "training").frames
    drives = [read_images(folder) for folder in sorted((arguments.data / "kitti_video").iterdir()) if folder.is_dir()]
    film = {drive.name: [frame for frame in drive.frames if frame.labelled][:: arguments.every] for drive in drives}
    everywhere: list[tuple[DriveFrame, Vehicles]] = []
    for place, frames in {"images": list(images), **film}.items():
        print(f"{place}, {len(frames)} frames")
        found = [(frame, detector(read_image(frame.image))) for frame in frames]
        report(found)
        everywhere += found if place in film else []
    print("all drives")
    report(everywhere)
    close_ups(detector, arguments.data)
    times = []
    for frame in images:
        image = read_image(frame.image)
        started = time.perf_counter()
        detector(image)
        times.append(1e3 * (time.perf_counter() - started))
    print(f"  {np.median(times):.0f} ms per image (least {min(times):.0f}), {arguments.threads} threads")


if __name__ == "__main__":
    main()
