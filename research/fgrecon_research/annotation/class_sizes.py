"""Sizes of the classes of vehicles by KITTI's labels, and what other programs call these classes."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from fgrecon.calibration.matching import match_detections
from fgrecon.calibration.selection import Selection
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.size_prior import CLASSES
from fgrecon.io.images import read_image
from fgrecon.io.kitti_drives import read_images
from fgrecon.io.kitti_files import Objects, parse_object
from fgrecon.perception.vehicles import VEHICLE_NAMES, NanodetVehicleDetector

KITTI = {"Car": "car", "Van": "van", "Truck": "lorry", "Tram": "tram"}
"""Ours by KITTI's names."""

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
_LEAST_SCORE = 0.1  # of a box that is counted: what looks like a bus is no good car
_OVERLAP = 0.5  # of a labelled and a detected box of one vehicle


def class_file(labels: Path, drives: Sequence[Path]) -> dict[str, Any]:
    """The content of `fgrecon/data/sizes/kitti.json`.

    nuScenes calls vans cars: one of its cars is what one of KITTI's cars and vans is.

    Args:
        labels: Folder of label files.
        drives: Labelled drives in which vehicles are counted by what a detector calls them.

    Raises:
        InvalidInputError: As `class_sizes` and `detector_classes`.
    """
    classes = class_sizes(labels)
    coco = detector_classes(drives, {name: one["share"] for name, one in classes.items()})
    either = classes["car"]["share"] + classes["van"]["share"]
    car = {name: round(classes[name]["share"] / either, 4) for name in ("car", "van")}
    nuscenes = {name: {one: 1.0} for name, one in _NUSCENES.items()} | {"car": car, "vehicle.car": car}
    sure = {scheme: {name: {one: 1.0} for name, one in names.items()} for scheme, names in _NAMES.items()}
    schemes = {**sure, "nuscenes": nuscenes, "coco": coco, "yolo": coco}
    return {"name": "kitti", "classes": classes, "schemes": schemes}


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
    return {name: found[name] for name in CLASSES}


def detector_classes(drives: Sequence[Path], share: Mapping[str, float]) -> dict[str, dict[str, float]]:
    """Probability of each class by what the package's vehicle detector calls a vehicle, by labelled drives.

    Each vehicle of a drive counts once, however many images show it. For what was not seen one vehicle of what the
    name means is added, and one that is of each class as often as all are.

    Args:
        drives: Folders of labelled drives.
        share: Of each class among all.

    Raises:
        InvalidInputError: A folder is no drive.
    """
    detector, called = NanodetVehicleDetector(), defaultdict[tuple[str, int, str], Counter[str]](Counter)
    for folder in drives:
        drive = read_images(folder.absolute())
        for frame in drive.frames:
            rows, _ = Selection(kinds=tuple(KITTI)).judge(frame)
            if not len(rows):
                continue
            found = detector(read_image(frame.image), least_score=_LEAST_SCORE)
            boxes = Objects.detections(["Car"] * len(found), found.boxes, np.ones(len(found)))
            labels = frame.objects.take(rows)
            as_cars = Objects.detections(["Car"] * len(rows), labels.box, np.ones(len(rows)))
            for row, at in zip(rows.tolist(), match_detections(as_cars, boxes, _OVERLAP).tolist(), strict=True):
                if at >= 0:
                    key = drive.name, int(frame.tracks[row]), KITTI[frame.objects.kind[row]]
                    called[key].update(found.classes[at].probabilities.keys())
    counted = {name: {one: share[one] + (one == _MEANT[name]) for one in CLASSES} for name in VEHICLE_NAMES}
    for (_, _, kind), names in called.items():
        for name, times in names.items():
            counted[name][kind] += times / names.total()
    return {
        name: {one: round(count / sum(counts.values()), 4) for one, count in counts.items()}
        for name, counts in counted.items()
    }
