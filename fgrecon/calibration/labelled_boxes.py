"""Labelled boxes of video drives, what was found in each, and its errors: also in units of the regions that it claims.

Cars and vans count that are at least 25 px high, largely occluded at most, and at most half outside the image (none
that is cut off where labels have grades in the place of shares, as KITTI's tracking set), in the frames where nothing
is drawn over them. Every box has one outcome by method: `SYSTEM` is the whole way from pixels to the pose; rivals get
the keypoints that it found. Nothing is left out: a refused box counts as 180 degrees.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.arrays import Array
from fgrecon.core.coverage import Coverage, Region, coverage
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.geometry import position_covariance
from fgrecon.core.metrics import orientation_error, translation_error, wrap_angle
from fgrecon.core.reconstruction import Reconstruction
from fgrecon.io.kitti_files import DriveFrame, Objects
from fgrecon.io.track_file import GroundTruth


class Reason(StrEnum):
    """Why an object has no keypoints. That the network disagrees is none: boxes are the truth."""

    DRAWN_OVER = "something is drawn over it"
    SMALL = "too small"
    OCCLUDED = "too occluded"
    TRUNCATED = "too much of it outside the image"
    OUTSIDE = "its 2D box is not in the image"
    NO_BOX = "no 3D box"
    """Neither is there one nor was there word of how to do without: see `fgrecon_research.annotation.unboxed`."""
    FEW_POINTS = "too few keypoints found"
    NO_MINIMUM = "no minimum of the graph"
    UNSURE = "not sure"
    """It has no 3D box, and its own reconstruction is not one to trust, or may face the other way."""


@dataclass(frozen=True)
class LeftOut:
    """An object of a selected kind without keypoints, and why."""

    frame: int  # number of the image
    track: int  # number of the vehicle
    reason: Reason  # why
    kind: str  # as labelled


@dataclass(frozen=True)
class Selection:
    """Which objects are annotated."""

    kinds: tuple[str, ...] = ("Car", "Van")
    height: float = 25.0  # least height of the 2D box, pixels
    occlusion: int = 2  # most of KITTI's grade
    truncation: float = 0.5  # largest share outside the image

    def __post_init__(self) -> None:
        """Check the limits.

        Raises:
            InvalidInputError: There is no kind, or a limit lets nothing through or is no number.
        """
        if not self.kinds:
            raise InvalidInputError("selection.kinds", "none", "Give at least one kind, such as Car.")
        if not self.height >= 0.0:
            raise InvalidInputError("selection.height", self.height, "Give pixels, from 0.")
        if self.occlusion < 0:
            raise InvalidInputError("selection.occlusion", self.occlusion, "Give KITTI's grade, from 0.")
        if not 0.0 <= self.truncation <= 1.0:
            raise InvalidInputError("selection.truncation", self.truncation, "Give a share from 0 to 1.")

    def judge(self, frame: DriveFrame) -> tuple[NDArray[np.intp], list[LeftOut]]:
        """A frame's objects of the selected kinds: indices of those to annotate, and why the others are not.

        What is unknown (-1) of truncation and occlusion speaks against none.
        """
        o = frame.objects
        rows, left = [], []
        for row, kind in enumerate(o.kind):
            if kind not in self.kinds:
                continue
            reason = None
            if not frame.usable[row]:
                reason = Reason.DRAWN_OVER
            elif o.box[row, 3] - o.box[row, 1] < self.height:
                reason = Reason.SMALL
            elif o.occlusion[row] > self.occlusion:
                reason = Reason.OCCLUDED
            elif o.truncation[row] > self.truncation:
                reason = Reason.TRUNCATED
            if reason is None:
                rows.append(row)
            else:
                left.append(LeftOut(frame.number, int(frame.tracks[row]), reason, kind))
        return np.array(rows, dtype=np.intp), left


DIMENSIONS = {"position": 3, "yaw": 1, "size": 3, "velocity": 2}
"""What normalised squared errors are of, and its dimension; velocity is over the ground."""


@dataclass(frozen=True)
class Claimed:
    """Errors by the covariances that a result has for them."""

    # normalised squared error by quantity; without those whose covariance is not determined
    squared: Mapping[str, float]
    spread: Mapping[str, float]  # geometric mean of the semi-axes of each one's one-sigma region, degrees or metres


def claimed(result: Reconstruction, position: Array, yaw: float, size: Array) -> Claimed:
    """The errors of position, yaw and size by the result's own covariances.

    Args:
        position: (3,) error of the location in the camera's frame, metres.
        yaw: Error about the vertical axis, radians.
        size: (3,) error of length, width and height, metres.
    """
    errors = {"position": position, "yaw": np.array([yaw]), "size": size}
    regions: dict[str, Array] = {}
    if result.uncertainty.pose_covariance is not None:
        regions["position"] = position_covariance(result.camera_T_object, result.uncertainty.pose_covariance)
        regions["yaw"] = result.uncertainty.pose_covariance[1:2, 1:2]  # about the vehicle's own vertical axis
    if result.uncertainty.size_covariance is not None:
        regions["size"] = result.uncertainty.size_covariance
    squared = {
        name: value
        for name, covariance in regions.items()
        if (value := normalised_squared_error(errors[name], covariance)) is not None
    }
    return Claimed(squared, {name: _radius(name, regions[name]) for name in squared})


def _radius(name: str, covariance: Array) -> float:
    radius = float(np.linalg.det(covariance)) ** (0.5 / len(covariance))
    return float(np.degrees(radius)) if name == "yaw" else radius


def normalised_squared_error(error: Array, covariance: Array) -> float | None:
    """Error (D,) by its covariance (D, D); None where that is not positive definite."""
    try:
        root = np.linalg.cholesky(covariance)
    except np.linalg.LinAlgError:
        return None
    white = np.linalg.solve(root, error)
    return float(white @ white)


MINIMUM_OVERLAP = {"Car": 0.7, "Pedestrian": 0.5, "Cyclist": 0.5}
"""Overlap that a match must exceed, by class."""


def box_overlap(first: Array, second: Array, *, of_first: bool = False) -> Array:
    """Overlap (M, N) of 2D boxes (M, 4) and (N, 4), x1, y1, x2, y2: intersection over union, or over the first."""
    low = np.maximum(first[:, None, :2], second[:, :2])
    high = np.minimum(first[:, None, 2:], second[:, 2:])
    side = np.maximum(high - low, 0.0)
    areas = [np.prod(box[:, 2:] - box[:, :2], axis=1) for box in (first, second)]
    return shared_ratio(side[..., 0] * side[..., 1], areas[0], areas[1], of_first=of_first)


def shared_ratio(inner: Array, first: Array, second: Array, *, of_first: bool) -> Array:
    """Intersections (M, N) over the union of what has these extents (M,) and (N,), or over the first of them."""
    whole = np.broadcast_to(first[:, None], inner.shape) if of_first else first[:, None] + second - inner
    return np.divide(inner, whole, out=np.zeros_like(inner), where=(inner > 0) & (whole > 0))


def match_detections(
    labels: Objects, detections: Objects, least: float = MINIMUM_OVERLAP["Car"], *, kind: str = "Car"
) -> NDArray[np.int64]:
    """For each label the detected car that overlaps it most, by more than KITTI's 0.7 or another; -1 where none does.

    A detection is given to one label at most: pairs are made in the order of their overlap.

    Args:
        least: Overlap that a detection must exceed.
        kind: Of the detections that are taken.
    """
    matched = np.full(len(labels), -1)
    if not len(labels) or not len(detections):
        return matched
    shared = box_overlap(labels.box, detections.box)
    shared[:, [other != kind for other in detections.kind]] = 0.0
    for flat in np.argsort(-shared, axis=None, kind="stable"):
        i, j = np.unravel_index(flat, shared.shape)
        if shared[i, j] <= least:
            break
        if matched[i] < 0 and not (matched == j).any():
            matched[i] = j
    return matched


FLIPPED_DEGREES = 90.0
"""Degrees of yaw error above which a vehicle's heading is flipped."""

SYSTEM = "reconstruct_image"
"""The whole way, which `fgrecon.reconstruct_image` goes: networks, both stages, and the network's direction."""


class View(StrEnum):
    """From where the vehicle is seen."""

    FRONT = "front"
    """The camera is within 45 degrees of ahead of it."""
    REAR = "rear"
    """Within 45 degrees of behind it."""
    SIDE = "side"


@dataclass(frozen=True)
class BoxOutcome:
    """What one method found in one box."""

    degrees: float  # yaw error on the full circle; 180 without a pose
    metres: float  # distance of the estimated from the labelled origin in the label's frame; infinite without a pose
    # estimated minus labelled length, width and height, metres; None where the method finds no size
    size: tuple[float, float, float] | None
    status: str | None  # how the reconstruction ended; None without one, and for a rival
    failure: str | None  # why there is no pose, or None
    # estimated minus labelled yaw in degrees, and origin (3) in metres; None where it was not wanted
    off: tuple[float, float, float, float] | None = None
    # normalised squared errors of `position`, `yaw`, `size` and `velocity`, as far as there are covariances
    # (`fgrecon.calibration.labelled_boxes`); none of a vehicle whose heading is flipped
    squared: Mapping[str, float] = field(default_factory=dict)
    # geometric mean of the one-sigma regions' semi-axes that those are by, degrees or metres
    spread: Mapping[str, float] = field(default_factory=dict)
    facing: float | None = None  # the result's `facing_probability`; None where it has none
    # distance of the estimated from the labelled velocity, metres per second; None where either is unknown
    velocity: float | None = None


@dataclass(frozen=True)
class VideoBox:
    """One labelled box of a drive."""

    drive: str  # name of the drive
    frame: int  # number of the frame
    index: int  # position among the frame's labels
    track: int  # number of the track in the drive
    kind: str  # `Car` or `Van`
    truncation: float  # share outside the image
    occlusion: int  # 0 fully visible, 1 partly, 2 largely occluded; -1 where unknown
    height: float  # of the labelled 2D box, pixels
    distance: float  # of the labelled origin from the labels' camera, metres
    azimuth: float  # labelled direction from the vehicle to the camera, radians; 0 ahead, pi / 2 to its left
    # probability that the network gives to directions within 90 degrees of the labelled one; None where it gives
    # no directions
    facing: float | None
    outcomes: Mapping[str, BoxOutcome]  # what each method found, by its name
    line: str = ""  # what the whole system found, as a line of KITTI's results; empty where it found nothing
    rotation_y: float = 0.0  # labelled yaw, radians
    # labelled length, width and height, metres; None where nobody compares 3D boxes
    size: tuple[float, float, float] | None = None
    points: int | None = None  # how many points of a LiDAR are inside the labelled 3D box; None where there is no LiDAR

    @property
    def view(self) -> View:
        """From where the vehicle is seen."""
        return view_of(self.azimuth)

    def rows(self) -> list[dict[str, Any]]:
        """Plain values, a row for each method; an infinite distance is None."""
        about = {
            "drive": self.drive,
            "frame": self.frame,
            "index": self.index,
            "track": self.track,
            "kind": self.kind,
            "truncation": self.truncation,
            "occlusion": self.occlusion,
            "height_px": self.height,
            "distance_m": self.distance,
            "view": self.view.value,
            "azimuth_deg": float(np.degrees(self.azimuth)),
            "facing": self.facing,
        } | ({} if self.points is None else {"points": self.points})
        rows = []
        for method, found in self.outcomes.items():
            length, width, height = found.size or (None, None, None)
            rows.append(
                about
                | {
                    "method": method,
                    "degrees": found.degrees,
                    "metres": found.metres if np.isfinite(found.metres) else None,
                    "length_error_m": length,
                    "width_error_m": width,
                    "height_error_m": height,
                    "status": found.status,
                    "failure": found.failure,
                    "velocity_error_m_s": found.velocity,
                    **{f"{name}_nees": found.squared.get(name) for name in DIMENSIONS},
                }
            )
        return rows


def wanted(frame: DriveFrame) -> NDArray[np.intp]:
    """Indices of the labels that count: those that are annotated by default, and have a 3D box to be scored by."""
    rows, _ = Selection().judge(frame)
    return rows[frame.boxed[rows]]


def matched(frame: DriveFrame, boxes: Objects, least: float) -> NDArray[np.int64]:
    """For each label that counts (`wanted`) the box that overlaps it most in the image, by more than that; or -1.

    A box that is a car's or van's that does not count is no other's. Where no box of a car is there, one of a van is
    taken: detectors call the same vehicle both.
    """
    rows = np.flatnonzero(np.isin(frame.objects.kind, Selection().kinds))
    labels = frame.objects.take(rows)
    at = match_detections(labels, boxes, least)
    without = np.flatnonzero(at < 0)
    at[without] = match_detections(labels.take(without), boxes, least, kind="Van")
    return at[np.isin(rows, wanted(frame))]


def view_of(azimuth: float) -> View:
    """Front, rear or side by the direction from the vehicle to the camera, radians."""
    off = abs(np.degrees(wrap_angle(azimuth)))
    return View.FRONT if off <= 45.0 else View.REAR if off >= 135.0 else View.SIDE


def outcome(result: Reconstruction, truth: GroundTruth, size: Array, offset: Array) -> BoxOutcome:
    """How far a result is off.

    Args:
        size: (3,) labelled length, width and height.
        offset: (3,) of the labels' frame in the camera's.
    """
    length, width, height = (result.box_size - size).tolist()
    turned = float(np.degrees(wrap_angle(result.rotation_y - truth.rotation_y)))
    x, y, z = (result.location - offset - truth.location).tolist()
    claims = claimed(result, np.array([x, y, z]), float(np.radians(turned)), result.box_size - size)
    return BoxOutcome(
        degrees=float(orientation_error([result.rotation_y], [truth.rotation_y])[0]),
        metres=float(translation_error([result.location - offset], [truth.location])[0]),
        size=(length, width, height),
        status=result.status.value,
        failure=None,
        off=(turned, x, y, z),
        squared={} if abs(turned) > FLIPPED_DEGREES else claims.squared,
        spread=claims.spread,
        facing=result.facing_probability if np.isfinite(result.facing_probability) else None,
    )


def claimed_regions(found: BoxOutcome, group: str) -> tuple[Region, ...]:
    """The errors of a result by the regions that it claims.

    Args:
        group: What its regions are left out of the baselines with.
    """
    errors = {"position": found.metres, "yaw": found.degrees}
    if found.size is not None:
        errors["size"] = float(np.linalg.norm(found.size))
    if found.velocity is not None:
        errors["velocity"] = found.velocity
    return tuple(
        Region(group, name, found.squared[name], DIMENSIONS[name], found.spread[name], error)
        for name, error in errors.items()
        if name in found.squared
    )


def box_coverage(boxes: Sequence[VideoBox]) -> list[Coverage]:
    """How much of what the system's regions claim they hold; drives are left out of their own baselines."""
    found = [(box, box.outcomes[SYSTEM]) for box in boxes]
    return coverage([r for box, one in found if one.status is not None for r in claimed_regions(one, box.drive)])
