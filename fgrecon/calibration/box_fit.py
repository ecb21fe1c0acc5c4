"""Edges of a detector's boxes relative to vehicles' outlines, fitted to labelled vehicles."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from fgrecon.calibration.labelled_boxes import wanted
from fgrecon.calibration.labelled_frames import SETTINGS, ScoredFrame
from fgrecon.core.arrays import Array
from fgrecon.core.detector_calibration import BoxSource
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.geometry import box_around, yaw_rotation
from fgrecon.core.shape_prior import ShapePrior
from fgrecon.io.kitti_files import Drive, DriveFrame
from fgrecon.solve.vehicle.model import VehicleModel, prepare

_MAD = 1.4826  # from the median absolute deviation to a normal standard deviation


@dataclass(frozen=True)
class DetectedOutline:
    """A detected box of a vehicle that can be seen as a whole."""

    detected: Array  # (4,) x1, y1, x2, y2, pixels
    outline: Array  # (4,) the same of the outline of the mean shape, scaled to the labelled size, in the labelled pose


def check_whole_cars(drives: Sequence[Drive]) -> None:
    """Refuse drives that cannot do before anything is detected."""
    count = 0
    for frame in (frame for drive in drives for frame in drive.frames):
        cars = frame.objects.take(wanted(frame))
        count += sum(map(_is_whole, cars.kind, cars.occlusion.tolist(), cars.truncation.tolist()))
    _check_count(count, "labelled cars that are visible as a whole")


def _is_whole(kind: str, occlusion: float, truncation: float) -> bool:
    return kind == "Car" and occlusion == 0 and truncation <= 0.0


def _check_count(count: int, what: str) -> None:
    if count < SETTINGS.fewest_vehicles:
        fix = f"Give drives with at least {SETTINGS.fewest_vehicles} cars that are visible as a whole and detected."
        raise InvalidInputError("drives", f"{count} {what}", fix)


def detected_outlines(
    drives: Sequence[Drive], frames: Iterable[ScoredFrame], prior: ShapePrior
) -> Iterator[DetectedOutline]:
    """The detected boxes of labelled cars that nothing hides and that are in the image as a whole."""
    plain = prepare(prior)
    labelled = {(drive.name, frame.number): frame for drive in drives for frame in drive.frames}
    for frame in frames:
        # the first sightings are those of the labelled boxes
        for box, sighting in zip(frame.boxes, frame.sightings, strict=False):
            if _is_whole(box.kind, box.occlusion, box.truncation):
                label = labelled[frame.drive, frame.number]
                yield DetectedOutline(np.asarray(sighting.box, dtype=np.float64), _outline(label, box.index, plain))


def _outline(frame: DriveFrame, index: int, plain: VehicleModel) -> Array:
    objects = frame.objects
    points = plain.outline.mean * (objects.size[index] / plain.dimension_mean)[[0, 2, 1]]
    place = objects.location[index] + frame.calibration.label_offset
    pixels = frame.calibration.camera.project(points @ yaw_rotation(float(objects.rotation_y[index])).T + place)
    return box_around(pixels)


def fit_boxes(boxes: Sequence[DetectedOutline]) -> BoxSource:
    """The medians of the edges' deviations, and how far edges vary about them.

    Raises:
        InvalidInputError: There are too few boxes.
    """
    _check_count(len(boxes), "detected cars that are visible as a whole")
    detected, outline = (np.array([getattr(one, name) for one in boxes]) for name in ("detected", "outline"))
    extent = detected[:, 2:] - detected[:, :2]
    off = (detected - outline) / np.tile(extent, 2)
    middle = np.median(off, axis=0)
    varying = (off - middle) * np.tile(extent, 2) / extent.max(axis=1, keepdims=True)
    left, upper, right, lower = middle.tolist()
    return BoxSource(left, upper, right, lower, _MAD * float(np.median(np.abs(varying))))
