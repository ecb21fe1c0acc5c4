"""3D boxes before and after `fgrecon.refine_boxes`, against labels: a detector's, or labels disturbed as one errs.

Vehicles count as in `fgrecon.calibration.labelled_boxes` (`wanted`). Those that a detector did not find are left out:
there is nothing to refine. A disturbed box lies farther or nearer on its ray, is seen some pixels aside, is turned, and
some have a heading flip; the 2D box is the labelled one.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgrecon.calibration.labelled_boxes import FLIPPED_DEGREES, matched, wanted
from fgrecon.core.arrays import Array
from fgrecon.core.box3d import Box3D, BoxErrors
from fgrecon.core.metrics import orientation_error
from fgrecon.core.refined_box import RefinedBox
from fgrecon.core.serialise import finite
from fgrecon.io.images import read_image
from fgrecon.io.kitti_files import Drive, DriveFrame, Objects
from fgrecon.io.run_settings import RunSettings
from fgrecon.perception.keypoints.detect import KeypointCascade
from fgrecon.perception.refine import refine_boxes
from fgrecon.simulation.sample import disturbed_boxes
from fgrecon_research.evaluation.boxes_summary import DISTANCES
from fgrecon_research.evaluation.measures import bands

_OVERLAP = 0.5  # in the image, above which a box is a labelled vehicle's
_WORSE = 5.0  # percent of the distance


@dataclass(frozen=True)
class BoxError:
    """How far a box is off."""

    metres: float  # distance of the origins
    degrees: float  # yaw error on the full circle
    size: tuple[float, ...]  # (3,) of length, width and height, metres, without sign


@dataclass(frozen=True)
class RefinedVehicle:
    """A labelled vehicle whose box was refined."""

    drive: str  # name of the drive
    frame: int  # number of the frame
    index: int  # position among the frame's labels
    kind: str  # `Car` or `Van`
    distance: float  # of the labelled origin, metres
    before: BoxError  # errors of the given box
    after: BoxError  # errors of the better one
    message: str  # what is said of it
    changed: bool  # whether it is another box
    # how far the better box is off, in its own standard deviations along the ray; NaN where it tells none
    within: float

    @property
    def worse(self) -> float:
        """By how much farther off it is, percent of its distance; below zero where it is nearer."""
        return 100.0 * (self.after.metres - self.before.metres) / self.distance


@dataclass(frozen=True)
class Comparison:
    """A group of vehicles, before and after."""

    vehicles: int  # how many there are
    refined: int  # how many boxes were changed
    mean_metres: tuple[float, ...]  # mean position error before and after, and so on
    median_metres: tuple[float, ...]  # the median
    mean_degrees: tuple[float, ...]  # of the yaw, on the full circle
    median_degrees: tuple[float, ...]  # the median
    flipped: tuple[int, ...]  # heading flips: vehicles off by more than 90 degrees
    # mean errors of length, width and height without sign, metres
    size: tuple[tuple[float, ...], ...]
    worse: int  # vehicles that lie farther off by more than 5 % of their distance
    worst_metres: float  # the largest rise of the position error, metres
    worst_percent: float  # the largest rise in percent of the distance
    doubled: int  # vehicles whose position error more than doubled
    spread: float  # standard deviation of the errors along the ray in terms of their own; 1 where those are right


@dataclass(frozen=True)
class Refinement:
    """How boxes are refined."""

    detector: KeypointCascade  # finds the keypoints
    settings: RunSettings  # what holds for every vehicle
    errors: BoxErrors  # how far the boxes are taken to be off


def refine_drive(
    drive: Drive,
    boxes: Mapping[int, Objects] | np.random.Generator,
    how: Refinement,
    *,
    every: int = 1,
    advance: Callable[[str], None] = lambda _: None,
) -> list[RefinedVehicle]:
    """Refine boxes of a drive's images, and score those of labelled vehicles.

    They are a detector's, by frame; or the labels, with errors from a source.
    """
    scored: list[RefinedVehicle] = []
    frames = [f for f in drive.frames if len(wanted(f)) > 0]
    if not isinstance(boxes, np.random.Generator):
        frames = [frame for frame in frames if frame.number in boxes]
    for frame in frames[::every]:
        labels, calibration = frame.objects.take(wanted(frame)), frame.calibration
        if isinstance(boxes, np.random.Generator):
            own, at = labels, np.arange(len(labels))
            true = _boxes(labels, calibration.label_offset)
            given = disturbed_boxes(true, calibration.camera, how.errors, boxes)
        else:
            own = boxes[frame.number]
            at, given = matched(frame, own, _OVERLAP), _boxes(own, calibration.label_offset)
        scored += _refine_frame(drive.name, frame, given, own.box, at, how)
        advance(drive.name)
    return scored


def compare(vehicles: Sequence[RefinedVehicle]) -> dict[str, Comparison]:
    """All vehicles, those of each drive, and by distance; groups without any are left out."""
    groups: dict[str, list[RefinedVehicle]] = defaultdict(list)
    groups["all"] = list(vehicles)
    for one in vehicles:
        groups[one.drive].append(one)
    groups |= bands(vehicles, DISTANCES, lambda one: one.distance, "m", "beyond {}")
    return {name: _comparison(members) for name, members in groups.items() if members}


def document(vehicles: Sequence[RefinedVehicle], given: Mapping[str, Any]) -> dict[str, Any]:
    """Plain values for JSON."""
    return {
        "format": "fgrecon.refinement/1",
        "given": dict(given),
        "groups": {name: finite(asdict(one)) for name, one in compare(vehicles).items()},
        "vehicles": [finite(asdict(one)) for one in vehicles],
    }


def _boxes(objects: Objects, offset: Array) -> list[Box3D]:
    """3D boxes in the camera's frame."""
    each = zip(objects.location, objects.rotation_y.tolist(), objects.size, strict=True)
    return [Box3D(location + offset, yaw, size) for location, yaw, size in each]


def _refine_frame(
    name: str, frame: DriveFrame, boxes: Sequence[Box3D], corners: Array, at: NDArray[np.int64], how: Refinement
) -> list[RefinedVehicle]:
    offset, labels, rows = frame.calibration.label_offset, frame.objects, wanted(frame)
    image = read_image(frame.image)
    camera = frame.calibration.camera.with_size_of(image)
    found = refine_boxes(
        image,
        boxes,
        camera,
        corners=corners,
        box_errors=how.errors,
        keypoint_detector=how.detector,
        **how.settings.arguments(),
    )
    scored = []
    for row, j in zip(rows.tolist(), at.tolist(), strict=True):
        if j < 0:
            continue
        one, place, yaw = found[j], labels.location[row] + offset, float(labels.rotation_y[row])
        scored.append(
            RefinedVehicle(
                drive=name,
                frame=frame.number,
                index=row,
                kind=labels.kind[row],
                distance=float(np.linalg.norm(labels.location[row])),
                before=_error(one.given, place, yaw, labels.size[row]),
                after=_error(one.box, place, yaw, labels.size[row]),
                message=one.message,
                changed=one.changed,
                within=_within(one, place),
            )
        )
    return scored


def _error(box: Box3D, place: Array, yaw: float, size: Array) -> BoxError:
    assert box.size is not None
    degrees = float(orientation_error([box.rotation_y], [yaw])[0])
    return BoxError(float(np.linalg.norm(box.location - place)), degrees, tuple(np.abs(box.size - size).tolist()))


def _within(one: RefinedBox, place: Array) -> float:
    if one.location_covariance is None:
        return float("nan")
    ray = place / np.linalg.norm(place)
    return float(ray @ (one.box.location - place) / np.sqrt(ray @ one.location_covariance @ ray))


def _comparison(vehicles: Sequence[RefinedVehicle]) -> Comparison:
    both = [[one.before for one in vehicles], [one.after for one in vehicles]]
    metres, degrees, sizes = (
        np.array([[getattr(error, name) for error in errors] for errors in both])
        for name in ("metres", "degrees", "size")
    )
    worse = np.array([one.worse for one in vehicles])
    within = np.array([one.within for one in vehicles if one.changed])
    return Comparison(
        vehicles=len(vehicles),
        refined=sum(one.changed for one in vehicles),
        mean_metres=tuple(metres.mean(axis=1).tolist()),
        median_metres=tuple(np.median(metres, axis=1).tolist()),
        mean_degrees=tuple(degrees.mean(axis=1).tolist()),
        median_degrees=tuple(np.median(degrees, axis=1).tolist()),
        flipped=tuple((degrees > FLIPPED_DEGREES).sum(axis=1).tolist()),
        size=tuple(map(tuple, sizes.mean(axis=1).tolist())),
        worse=int((worse > _WORSE).sum()),
        worst_metres=float((metres[1] - metres[0]).max()),
        worst_percent=float(worse.max()),
        doubled=int((metres[1] > 2.0 * metres[0]).sum()),
        spread=float(np.sqrt(np.square(within).mean())) if len(within) else float("nan"),
    )
