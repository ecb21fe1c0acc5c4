"""Sizes of vehicle classes by KITTI's labels, and the names of these classes in other programs."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgrecon.calibration.labelled_boxes import Selection
from fgrecon.core.errors import InvalidInputError
from fgrecon.io.images import read_image
from fgrecon.io.kitti_files import parse_object, read_images
from fgrecon.perception.vehicles import VEHICLE_NAMES, NanodetVehicleDetector

KITTI = {"Car": "car", "Van": "van", "Truck": "lorry", "Tram": "tram"}
"""Ours by KITTI's names."""

CLASSES = ("car", "van", "lorry", "bus", "tram")
"""Ours, the usual one first."""

_FITTED: dict[str, dict[str, Any]] = {
    "van": {"odds": {"fleet": -1.0, "given": 0.75}},
    **{name: {"shape": "cuboid14"} for name in ("lorry", "bus", "tram")},
}
"""What was chosen of a class on drives (`fgrecon/data/sizes/kitti.md`)."""

_NAMES = {
    "fgrecon": {name: name for name in CLASSES} | {"truck": "lorry"},
    "kitti": {name.lower(): one for name, one in KITTI.items()},
    "openlabel": {
        start + name: one
        for start in ("", "vehicle")
        for name, one in {
            **{name: name for name in CLASSES},
            **dict.fromkeys(("truck", "trailer", "construction", "agricultural"), "lorry"),
            **dict.fromkeys(("caravan", "emergency"), "van"),
        }.items()
    },
}
_NUSCENES = {
    **dict.fromkeys(("truck", "trailer", "construction_vehicle", "vehicle.truck", "vehicle.trailer"), "lorry"),
    **dict.fromkeys(("bus", "vehicle.bus.rigid", "vehicle.bus.bendy"), "bus"),
    "vehicle.construction": "lorry",
    "vehicle.emergency.police": "car",
    "vehicle.emergency.ambulance": "van",
}
_BUS = {"mean": [11.189, 2.940, 3.470], "source": "nuScenes, mean size of the class bus as detectors' anchors have it"}
_MEANT = {"car": "car", "bus": "bus", "train": "tram", "truck": "lorry"}  # by COCO's names
_NEWTON_STEPS, _RIDGE = 20, 1e-5  # of the logistic regression


def class_file(labels: Path, drives: Sequence[Path]) -> dict[str, Any]:
    """The content of `fgrecon/data/sizes/kitti.json`.

    nuScenes calls vans cars: one of its cars is what one of KITTI's cars and vans is.

    Args:
        labels: Folder of label files.
        drives: Labelled drives in which vehicles are counted by what a detector calls them.

    Raises:
        InvalidInputError: As `class_sizes` and `detected_vehicles`.
    """
    classes = class_sizes(labels)
    share = {name: one["share"] for name, one in classes.items()}
    vehicles = detected_vehicles(drives)
    coco = detector_classes(vehicles, share)
    either = classes["car"]["share"] + classes["van"]["share"]
    car = {name: round(classes[name]["share"] / either, 4) for name in ("car", "van")}
    nuscenes = {name: {one: 1.0} for name, one in _NUSCENES.items()} | {"car": car, "vehicle.car": car}
    sure = {scheme: {name: {one: 1.0} for name, one in names.items()} for scheme, names in _NAMES.items()}
    schemes = {**sure, "nuscenes": nuscenes, "coco": coco, "yolo": coco}
    return {"name": "kitti", "classes": classes, "schemes": schemes, "detector": detector_odds(vehicles, share)}


def class_sizes(labels: Path) -> dict[str, Any]:
    """Mean and covariance of length, width and height of each class, and its share of all, by a folder of label files.

    Of buses, which KITTI has none of, the mean is published; they spread as lorries do, in shares of their size.

    Raises:
        InvalidInputError: There is no label file, or fewer than four vehicles of a class.
    """
    sizes: dict[str, list[list[float]]] = defaultdict(list)
    files = sorted(labels.glob("*.txt"))
    for file in files:
        for line in file.read_text(encoding="utf-8").splitlines():
            kind, numbers = parse_object(line)
            if kind in KITTI and min(numbers[7:10]) > 0.0:
                height, width, length = numbers[7:10]
                sizes[KITTI[kind]].append([length, width, height])
    few = [name for name in KITTI.values() if len(sizes[name]) < len(KITTI)]
    if few:
        raise InvalidInputError("labels", str(labels), f"Give label files of KITTI; too few are of a {few[0]}.")
    found: dict[str, Any] = {}
    total = sum(map(len, sizes.values()))
    for name, rows in sizes.items():
        found[name] = {
            "count": len(rows),
            "share": round(len(rows) / total, 4),
            "mean": np.mean(rows, axis=0).round(3).tolist(),
            "covariance": np.cov(np.transpose(rows)).round(4).tolist(),
        }
    ratio = np.array(_BUS["mean"]) / np.array(found["lorry"]["mean"])
    spread = (np.array(found["lorry"]["covariance"]) * np.outer(ratio, ratio)).round(4).tolist()
    found["bus"] = {"count": 0, "share": 0.0, "covariance": spread, **_BUS}
    return {name: {**found[name], **_FITTED.get(name, {})} for name in CLASSES}


@dataclass(frozen=True)
class DetectedVehicle:
    """A labelled vehicle of a drive, and what the package's detector makes of it."""

    kind: str  # its class
    numbers: NDArray[np.float64]  # (M, 4) of `VEHICLE_NAMES` in each image in which it is detected


def detected_vehicles(drives: Sequence[Path]) -> list[DetectedVehicle]:
    """The vehicles of labelled drives that the package's detector takes for a vehicle at all.

    Raises:
        InvalidInputError: A folder is no drive.
    """
    detector, found = NanodetVehicleDetector(), defaultdict[tuple[str, int, str], list[NDArray[np.float64]]](list)
    for folder in drives:
        drive = read_images(folder.absolute())
        for frame in drive.frames:
            rows, _ = Selection(kinds=tuple(KITTI)).judge(frame)
            if not len(rows):
                continue
            numbers = detector.class_numbers(read_image(frame.image), frame.objects.box[rows])
            for row, one in zip(rows.tolist(), numbers, strict=True):
                if one is not None:
                    found[drive.name, int(frame.tracks[row]), KITTI[frame.objects.kind[row]]].append(one)
    return [DetectedVehicle(kind, np.array(some)) for (_, _, kind), some in found.items()]


def detector_classes(vehicles: Sequence[DetectedVehicle], share: Mapping[str, float]) -> dict[str, dict[str, float]]:
    """Probability of each class by what the package's detector calls a vehicle.

    Each vehicle counts once, however many images show it. For what was not seen one vehicle of what the name means is
    added, and one that is of each class as often as all are: by its share.
    """
    counted = {name: {one: share[one] + (one == _MEANT[name]) for one in CLASSES} for name in VEHICLE_NAMES}
    for vehicle in vehicles:
        called = np.bincount(vehicle.numbers.argmax(axis=1), minlength=len(VEHICLE_NAMES))
        for name, times in zip(VEHICLE_NAMES, (called / called.sum()).tolist(), strict=True):
            counted[name][vehicle.kind] += times
    return {
        name: {one: round(count / sum(counts.values()), 4) for one, count in counts.items()}
        for name, counts in counted.items()
    }


def detector_odds(vehicles: Sequence[DetectedVehicle], share: Mapping[str, float]) -> dict[str, float]:
    """Offset and slope of the odds of a van against a car, nats, by how much more it is taken for a truck.

    A logistic regression, to which each vehicle counts once and each class as often as it is among all: by its share.

    Raises:
        InvalidInputError: No car or no van is among them.
    """
    known = {kind: [one.numbers for one in vehicles if one.kind == kind] for kind in ("car", "van")}
    if not all(known.values()):
        raise InvalidInputError("drives", "no car or no van", "Give drives with both, in which they are detected.")
    truck, car = VEHICLE_NAMES.index("truck"), VEHICLE_NAMES.index("car")
    rows, weights, is_van = list[NDArray[np.float64]](), list[NDArray[np.float64]](), list[NDArray[np.float64]]()
    for kind, some in known.items():
        for numbers in some:
            rows.append(numbers[:, truck] - numbers[:, car])
            weights.append(np.full(len(numbers), share[kind] / len(some) / len(numbers)))
            is_van.append(np.full(len(numbers), float(kind == "van")))
    margin, weight, target = (np.concatenate(each) for each in (rows, weights, is_van))
    design, found = np.stack([np.ones_like(margin), margin], axis=1), np.zeros(2)
    for _ in range(_NEWTON_STEPS):
        probability = 1.0 / (1.0 + np.exp(-design @ found))
        slope = design.T @ (weight * (probability - target)) + _RIDGE * found
        curvature = (design.T * (weight * probability * (1.0 - probability))) @ design + _RIDGE * np.eye(2)
        found = found - np.linalg.solve(curvature, slope)
    return dict(zip(("offset", "slope"), found.round(2).tolist(), strict=True))
