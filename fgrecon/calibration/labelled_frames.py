"""Frames of video drives as single images: from pixels to poses, each scored by its label.

Looked at are the labelled boxes that count, or where a setup has a vehicle detector all that it finds. Of those a
labelled box has the one that overlaps it most, by more than half; a label without one is not scored but counted.

Scene knowledge is what rivals are given; the settings are those of the fits of a detector to what was found.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from fgrecon.calibration.labelled_boxes import (
    MINIMUM_OVERLAP,
    SYSTEM,
    BoxOutcome,
    VideoBox,
    matched,
    outcome,
    wanted,
)
from fgrecon.core.arrays import Array
from fgrecon.core.camera import Camera, Ground
from fgrecon.core.choices import ClassScheme, ClassSource
from fgrecon.core.detection import facing_probability
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.evidence import VehicleClass
from fgrecon.core.geometry import view_azimuth, yaw_rotation
from fgrecon.core.metrics import FAILURE_DEGREES
from fgrecon.core.options import Options
from fgrecon.core.processes import processes_with
from fgrecon.core.shape_prior import ShapePrior
from fgrecon.core.size_prior import SizePrior
from fgrecon.io.export.dataset_results import kitti_text
from fgrecon.io.export.results import NamedResult
from fgrecon.io.images import read_image
from fgrecon.io.kitti_files import Drive, DriveFrame, Objects
from fgrecon.io.track_file import GroundTruth, TrackFrame
from fgrecon.perception.boxes import classes_at, large_vehicles
from fgrecon.perception.from_image import FromImage, reconstruct_image
from fgrecon.perception.keypoints.detect import KeypointCascade
from fgrecon.perception.protocols import VehicleDetector
from fgrecon.video.records import Sighting


@dataclass(frozen=True)
class CalibrationSettings:
    """What a detector is fitted by, and when a fit is warned of. Where nothing else is said, not tuned."""

    common_factors: tuple[float, ...] = (1.0, 2.0, 4.0, 8.0, 16.0, 32.0)  # that are tried
    fewest_vehicles: int = 30  # that regions, or the edges of boxes, are judged by
    fewest_flipped: int = 5  # vehicles, without which nothing tells what a direction counts
    facing_bounds: tuple[tuple[float, float], ...] = ((-10.0, 10.0), (0.0, 10.0))  # of `facing_bias` and `facing_slope`
    tolerated_shortfall: float = 0.1
    """Share that regions hold less than they claim at most; those of the shipped networks are short by 0.09."""
    matching_overlap: float = 0.5  # intersection over union from which on a detected box is a labelled one's


SETTINGS = CalibrationSettings()


@dataclass(frozen=True)
class SceneKnowledge:
    """What the user knows; each method is given the part that its name says."""

    prior: ShapePrior  # shape prior of the category
    ground: Ground  # ground plane in the camera's frame
    size: SizePrior  # size of the fleet


@dataclass(frozen=True)
class Setup:
    """What every car is reconstructed with."""

    detector: KeypointCascade  # finds the keypoints
    prior: ShapePrior
    ground: Ground | None  # ground plane, or None
    size_prior: SizePrior | None  # fleet, or None
    options: Options  # settings
    overlap: float = MINIMUM_OVERLAP["Car"]  # from which overlap on a detected box is a labelled car's
    together: bool = True  # whether the vehicles of an image share one ground (`fgrecon.reconstruct_scene`)
    # finds the vehicles in frames of drives; None where the labelled boxes are the input
    vehicles: VehicleDetector | None = None
    classes: ClassSource | None = None  # who says of which class they are, or None
    # the vehicle detector that says so of labelled boxes, where a detector does
    classifier: VehicleDetector | None = None


def reconstruct_boxes(
    image: NDArray[np.uint8],
    camera: Camera,
    boxes: Sequence[Array],
    setup: Setup,
    classes: Sequence[VehicleClass | None] | Literal["keypoints"] | None = None,
) -> list[FromImage]:
    """What is found in the boxes (4,) of an image, by their classes; their parts outside the image are cut off."""
    limits = np.array([image.shape[1], image.shape[0]] * 2) - 1.0
    return reconstruct_image(
        image,
        camera,
        np.clip(np.reshape(boxes, (-1, 4)), 0.0, limits),
        keypoint_detector=setup.detector,
        prior=setup.prior,
        ground=setup.ground,
        size_prior=setup.size_prior,
        options=setup.options,
        together=setup.together,
        classes=classes,
    )


@dataclass(frozen=True, eq=False)
class ReconstructedVehicle:
    """One vehicle of an image that was looked at."""

    # position among the frame's labels of the box that counts and that it is of; None where it is of none
    label: int | None
    score: float  # of its detection; 1 for a labelled box
    found: FromImage


@dataclass(frozen=True, eq=False)
class ReconstructedFrame:
    """The labelled boxes of a frame that count and were looked at, for other methods."""

    drive: str  # name of the drive
    frame: DriveFrame  # the frame with its labels
    image: NDArray[np.uint8]  # (H, W, 3) its pixels
    camera: Camera  # the camera, with the size of the image
    setup: Setup  # what the boxes were reconstructed with
    vehicles: tuple[ReconstructedVehicle, ...]  # what was found in each

    def truth(self, vehicle: ReconstructedVehicle) -> GroundTruth:
        """The labelled place and yaw of a box."""
        labels = self.frame.objects
        return GroundTruth(labels.location[vehicle.label], float(labels.rotation_y[vehicle.label]))

    def keypoints(self) -> list[TrackFrame]:
        """The keypoints of each box with its truth."""
        name = f"{self.drive}:{self.frame.number}"
        return [TrackFrame(name, vehicle.found.detection.observation, self.truth(vehicle)) for vehicle in self.vehicles]


Rivals = Callable[[ReconstructedFrame], Sequence[Mapping[str, BoxOutcome]]]
"""Scores other methods by name, on each labelled box of a frame."""


@dataclass(frozen=True, eq=False)
class ScoredFrame:
    """A frame of a drive."""

    drive: str  # name of the drive
    number: int  # of the frame
    boxes: list[VideoBox]  # the labelled boxes that count and were looked at
    # all that was looked at; the first are those of `boxes`, with the labelled tracks for identities
    sightings: tuple[Sighting, ...]
    missed: int  # how many labelled boxes that count were not found


def no_rivals() -> Rivals:
    """What scores no other method."""
    return lambda solved: [{} for _ in solved.vehicles]


def frames_to_score(drive: Drive, setup: Setup) -> list[DriveFrame]:
    """The frames of a drive to look at: those with a box that counts, or all where vehicles are to be detected."""
    return [frame for frame in drive.frames if setup.vehicles is not None or len(wanted(frame)) > 0]


def reconstruct_frame(frame: DriveFrame, setup: Setup) -> tuple[NDArray[np.uint8], list[ReconstructedVehicle]]:
    """The frame's image (H, W, 3), and what is found in it; labelled boxes come first, in the order of the labels.

    Raises:
        InvalidInputError: The image cannot be read, or a box is outside it; names the image.
    """
    image = read_image(frame.image)
    camera = frame.calibration.camera.with_size_of(image)
    labels = wanted(frame)
    known: list[int | None] = [*labels.tolist()]
    boxes, scores, classes = frame.objects.box[labels], np.ones(len(labels)), list[VehicleClass | None]()
    if setup.vehicles is not None:
        vehicles = large_vehicles(image, setup.vehicles)
        known, order = _labels_of(frame, vehicles.boxes)
        vehicles = vehicles.take(np.array(order, dtype=np.intp))
        boxes, scores, classes = vehicles.boxes, vehicles.scores, list(vehicles.classes)
    try:
        named = _classes(frame, image, known, boxes, classes, setup)
        found = reconstruct_boxes(image, camera, list(boxes), setup, named)
    except InvalidInputError as error:
        raise InvalidInputError(f"{frame.image}: {error.field}", error.value, error.fix) from error
    return image, [ReconstructedVehicle(*one) for one in zip(known, scores.tolist(), found, strict=True)]


def _classes(
    frame: DriveFrame,
    image: NDArray[np.uint8],
    known: Sequence[int | None],
    boxes: Array,
    detected: Sequence[VehicleClass | None],
    setup: Setup,
) -> Sequence[VehicleClass | None] | Literal["keypoints"] | None:
    """Of which class each box (M, 4) is, of the label known[m]; None where nobody is to say."""
    if setup.classes is None:
        return None
    if setup.classes is ClassSource.KEYPOINTS:
        return "keypoints"
    if setup.classes is ClassSource.LABELS:
        kinds = frame.objects.kind
        return [None if label is None else VehicleClass(kinds[label], ClassScheme.KITTI) for label in known]
    if setup.vehicles is not None or setup.classifier is None:
        return detected
    return classes_at(boxes, image, setup.classifier)


def _labels_of(frame: DriveFrame, boxes: Array) -> tuple[list[int | None], list[int]]:
    """The label that counts of each detected box (M, 4), and its number; those with one come first."""
    detected = Objects.detections(["Car"] * len(boxes), boxes, np.ones(len(boxes)))
    at = zip(wanted(frame).tolist(), matched(frame, detected, SETTINGS.matching_overlap).tolist(), strict=True)
    pairs: list[tuple[int | None, int]] = [(row, number) for row, number in at if number >= 0]
    named = {number for _, number in pairs}
    pairs += [(None, number) for number in range(len(boxes)) if number not in named]
    return [label for label, _ in pairs], [number for _, number in pairs]


def score_frames(
    drives: Sequence[Drive],
    setups: Mapping[str, Setup],
    *,
    rivals: Callable[[], Rivals] | None = None,
    jobs: int = 1,
    advance: Callable[[str], None] = lambda _: None,
) -> list[ScoredFrame]:
    """Look at every frame of `frames_to_score`, and score the boxes that count.

    Args:
        setups: What each drive is reconstructed with, by its name.
        rivals: Makes, in each process, what scores other methods on the same keypoints; picklable.
        jobs: Number of processes; 1 uses this one. Each of several uses one thread, and the results do not depend on
            how many they are.
        advance: Called with the drive's name after each of its frames.

    Raises:
        InvalidInputError: An image or box cannot be used.
    """
    tasks = [(drive.name, frame) for drive in drives for frame in frames_to_score(drive, setups[drive.name])]
    make = partial(_Worker, setups, rivals or no_rivals)
    scored: list[ScoredFrame] = []
    with ExitStack() as stack:
        if jobs > 1:
            pool, run = stack.enter_context(processes_with(make, jobs))
            found: Iterator[ScoredFrame] = pool.map(run, tasks)
        else:
            found = map(make(), tasks)
        for frame in found:
            scored.append(frame)
            advance(frame.drive)
    return scored


_Task = tuple[str, DriveFrame]


class _Worker:
    """What a process keeps between frames."""

    def __init__(self, setups: Mapping[str, Setup], rivals: Callable[[], Rivals]) -> None:
        self.setups = setups
        self.rivals = rivals()

    def __call__(self, task: _Task) -> ScoredFrame:
        drive, frame = task
        return _score_frame(drive, frame, self.setups[drive], self.rivals)


def _score_frame(drive: str, frame: DriveFrame, setup: Setup, rivals: Rivals) -> ScoredFrame:
    image, vehicles = reconstruct_frame(frame, setup)
    camera = frame.calibration.camera.with_size_of(image)
    labelled = ReconstructedFrame(drive, frame, image, camera, setup, tuple(o for o in vehicles if o.label is not None))
    others = iter(rivals(labelled))
    boxes, sightings = [], []
    for vehicle in vehicles:
        track = None
        if vehicle.label is not None:
            boxes.append(_scored(labelled, vehicle, next(others)))
            track = boxes[-1].track
        observation = vehicle.found.detection.evidence
        assert observation.box is not None
        sightings.append(Sighting(observation.box, vehicle.score, track, observation))
    return ScoredFrame(drive, frame.number, boxes, tuple(sightings), len(wanted(frame)) - len(boxes))


def _scored(solved: ReconstructedFrame, vehicle: ReconstructedVehicle, others: Mapping[str, BoxOutcome]) -> VideoBox:
    """A labelled box with what was found, and with the outcomes of other methods."""
    frame, index, one = solved.frame, vehicle.label, vehicle.found
    assert index is not None
    labels, offset, truth = frame.objects, frame.calibration.label_offset, solved.truth(vehicle)
    azimuth = float(view_azimuth(yaw_rotation(truth.rotation_y), truth.location + offset))
    directions = one.detection.azimuth
    length, width, height = labels.size[index].tolist()
    return VideoBox(
        drive=solved.drive,
        frame=frame.number,
        index=index,
        track=int(frame.tracks[index]),
        kind=labels.kind[index],
        truncation=float(labels.truncation[index]),
        occlusion=int(labels.occlusion[index]),
        height=float(labels.box[index, 3] - labels.box[index, 1]),
        distance=float(np.linalg.norm(truth.location)),
        azimuth=azimuth,
        facing=None if directions is None else facing_probability(directions, azimuth),
        outcomes={SYSTEM: found_outcome(one, truth, labels.size[index], offset), **others},
        line=_line(one, labels.box[index], offset),
        rotation_y=truth.rotation_y,
        size=(length, width, height),
    )


def _line(found: FromImage, box: Array, offset: Array) -> str:
    if found.result is None:
        return ""
    return kitti_text([NamedResult("", found.result, box, offset)])


def found_outcome(found: FromImage, truth: GroundTruth, size: Array, offset: Array) -> BoxOutcome:
    """The outcome of what was found in an image; truth and size (3,) are the label's, in whose frame offset (3,) is."""
    return failed(str(found.error)) if found.result is None else outcome(found.result, truth, size, offset)


def failed(reason: str) -> BoxOutcome:
    """The outcome of a box without a pose."""
    return BoxOutcome(FAILURE_DEGREES, float("inf"), None, None, reason)
