"""From KITTI's photographs to poses: the networks and both stages on every labelled car of some images."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgrecon.calibration.labelled_boxes import BoxOutcome, match_detections
from fgrecon.calibration.labelled_frames import Setup, failed, found_outcome, reconstruct_boxes
from fgrecon.core.arrays import Array
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.serialise import finite
from fgrecon.io.export.dataset_results import kitti_objects
from fgrecon.io.export.results import NamedResult
from fgrecon.io.images import read_image
from fgrecon.io.kitti_calibration import KittiCalibration, read_calibration
from fgrecon.io.kitti_files import Objects
from fgrecon.io.track_file import GroundTruth
from fgrecon.perception.from_image import FromImage
from fgrecon_research.evaluation.boxes3d import LabelledBox, scored_box
from fgrecon_research.evaluation.boxes_summary import (
    OverlapSummary,
    Precision,
    by_distance,
    precisions,
    summarise_group,
)
from fgrecon_research.evaluation.kitti_devkit import REGIMES, counted_cars
from fgrecon_research.evaluation.measures import THRESHOLDS, instances_within
from fgrecon_research.io.kitti_sets import Defect, Fault, read_detections, read_labels


@dataclass(frozen=True)
class ImageFrame:
    """What there is of one image."""

    name: str  # the frame
    image: Path  # its file
    labels: Objects  # all labelled objects
    detections: Objects | None  # detected objects, or None where the labelled boxes are the input
    calibration: KittiCalibration  # camera and label offset


@dataclass(frozen=True)
class Car:
    """One labelled car that counts in some regime."""

    frame: ImageFrame
    index: int  # position in its label file
    truth: GroundTruth  # its label, in the camera's frame
    regimes: NDArray[np.bool_]  # (3,) whether Easy, Moderate and Hard count it
    box: Array | None  # (4,) the box that was looked at, or None without a detection that overlaps it enough
    score: float | None  # of that detection; None without one, and where the labelled box was looked at
    found: FromImage | None  # what was found, or None without a box
    outcome: BoxOutcome  # how far that is off

    @property
    def name(self) -> str:
        """Its frame and position."""
        return f"{self.frame.name}/{self.index}"


def read_frames(
    images: Path, labels: Path, calib: Path, names: Sequence[str] | None = None, detections: Path | None = None
) -> tuple[list[ImageFrame], list[Fault]]:
    """The frames that have an image.

    Args:
        names: Frames to take; None takes all images.
        detections: File of 2D detections, or None for the labelled boxes.

    Returns:
        Frames in alphabetical order, and what was wrong with files of theirs.

    Raises:
        InvalidInputError: There is no image, or a frame lacks label or calibration.
    """
    if not images.is_dir():
        raise InvalidInputError("images", str(images), "Give a folder of images named by frame.")
    files = {path.stem: path for path in sorted(images.iterdir()) if path.suffix.lower() in (".png", ".jpg", ".jpeg")}
    absent = [name for name in names or () if name not in files]
    files = {name: path for name, path in files.items() if names is None or name in names}
    if not files:
        raise InvalidInputError("images", str(images), "Give a folder with images of these frames.")
    objects, problems = read_labels(labels, list(files))
    problems += [Fault(Defect.MISSING_FRAME, name, "no image") for name in absent]
    missing = [name for name in files if name not in objects]
    if missing:
        raise InvalidInputError("labels", f"no label of {missing[0]}", "Give the folder with a label file per frame.")
    found: dict[str, Objects] | None = None
    if detections is not None:
        found, others = read_detections(detections, list(files))
        problems += [problem for problem in others if problem.place in files]
    frames = [
        ImageFrame(
            name,
            path,
            objects[name],
            None if found is None else found[name],
            read_calibration(calib / f"{name}.txt"),
        )
        for name, path in sorted(files.items())
    ]
    return frames, problems


def score_frame(frame: ImageFrame, setup: Setup) -> list[Car]:
    """Reconstruct every car of a frame that counts in some regime; all boxes pass through the network at once."""
    labels = frame.labels
    chosen, regimes = counted_cars(labels)
    if not len(chosen):
        return []
    image = read_image(frame.image)
    boxes: list[Array | None] = [labels.box[i] for i in chosen]
    scores: list[float | None] = [None] * len(chosen)
    if frame.detections is not None:
        at = match_detections(labels.take(chosen), frame.detections, setup.overlap)
        boxes = [frame.detections.box[i] if i >= 0 else None for i in at]
        scores = [float(frame.detections.score[i]) if i >= 0 else None for i in at]
    camera = frame.calibration.camera.with_size_of(image)
    results = iter(reconstruct_boxes(image, camera, [box for box in boxes if box is not None], setup))
    cars = []
    for index, counts, box, score in zip(chosen.tolist(), regimes, boxes, scores, strict=True):
        found = None if box is None else next(results)
        truth = GroundTruth(labels.location[index] + frame.calibration.label_offset, float(labels.rotation_y[index]))
        off = failed("no detection")
        if found is not None:
            off = found_outcome(found, truth, labels.size[index], np.zeros(3))
        cars.append(Car(frame, index, truth, counts, box, score, found, off))
    return cars


def summarise(cars: Sequence[Car]) -> list[dict[str, Any]]:
    """The numbers of each regime that has a car, over all of its cars (cumulative, as KITTI counts)."""
    scores = []
    for row, regime in enumerate(REGIMES):
        own = [car.outcome for car in cars if car.regimes[row]]
        if not own:
            continue
        degrees, metres = np.array([one.degrees for one in own]), np.array([one.metres for one in own])
        within = {str(threshold): instances_within(degrees, threshold) for threshold in THRESHOLDS}
        scores.append(
            {
                "name": regime.name,
                "cars": len(own),
                "aop": {threshold: count / len(own) for threshold, count in within.items()},
                "within": within,
                "mean_degrees": float(degrees.mean()),
                "median_degrees": float(np.median(degrees)),
                "median_metres": float(np.median(metres)),
                "failures": sum(one.failure is not None for one in own),
            }
        )
    return scores


def document(cars: Sequence[Car], given: dict[str, Any]) -> dict[str, Any]:
    """Everything as plain values for JSON: what was given, the regimes, and each car."""
    return {
        "format": "fgrecon.kitti-images/1",
        "given": given,
        "regimes": [finite(score) for score in summarise(cars)],
        "cars": [
            {
                "frame": car.frame.name,
                "index": car.index,
                "regimes": [regime.name for regime, member in zip(REGIMES, car.regimes, strict=True) if member],
                "box": None if car.box is None else car.box.tolist(),
                "degrees": car.outcome.degrees,
                "metres": finite(car.outcome.metres),
                "failure": car.outcome.failure,
                "status": car.outcome.status,
            }
            for car in cars
        ],
    }


# The 3D boxes of KITTI's images that `evaluation.kitti_images` reconstructed, against the labelled ones.


@dataclass(frozen=True, eq=False)
class ImageBoxes:
    """Boxes of some images."""

    results: Mapping[str, Objects]  # what was found as KITTI's results, by frame; none in frames where nothing was
    vehicles: Sequence[LabelledBox]  # every car that counts in some regime, with its box
    # summaries of the regimes, which are cumulative, and of the last one by distance
    groups: Mapping[str, OverlapSummary]
    # average precision by regime. There are no boxes but those of labelled cars, and so none that are wrong.
    curves: Sequence[Precision]


def score_boxes(frames: Sequence[ImageFrame], cars: Sequence[Car]) -> ImageBoxes:
    """Set the boxes of the cars beside the labelled ones; images err apart from one another.

    Args:
        cars: All of their cars that count (`fgrecon_research.evaluation.kitti_images.score_frame`).
    """
    named: dict[str, list[NamedResult]] = {frame.name: [] for frame in frames}
    vehicles = []
    for car in cars:
        frame, box = car.frame, None
        if car.found is not None and car.found.result is not None:
            one = NamedResult("", car.found.result, car.box, frame.calibration.label_offset, score=car.score)
            named[frame.name].append(one)
            box = kitti_objects([one]) if one.solved else None
        folder, label = frame.image.parent.parent.name, frame.labels.take(np.array([car.index]))
        vehicles.append(scored_box(folder, frame.name, car.index, frame.name, label, box))
    results = {name: kitti_objects(found) for name, found in named.items()}
    groups = {
        regime.name: [one for car, one in zip(cars, vehicles, strict=True) if car.regimes[row]]
        for row, regime in enumerate(REGIMES)
    }
    last = REGIMES[-1].name
    groups |= by_distance(last, groups[last])
    summaries = {name: summarise_group(members) for name, members in groups.items() if members}
    curves = precisions({frame.name: frame.labels for frame in frames}, results)
    return ImageBoxes(results, vehicles, summaries, curves)
