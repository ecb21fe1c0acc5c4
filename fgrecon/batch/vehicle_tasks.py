"""One task for each vehicle of a keypoint file, a track or an image: what is known of it and of its camera."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cache, lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.camera import Camera
from fgrecon.core.category import Category
from fgrecon.core.choices import BoxModel, ClassSource
from fgrecon.core.errors import FgreconError, InvalidInputError
from fgrecon.core.evidence import Evidence
from fgrecon.core.input_warnings import InputWarnings, camera_warning_of, input_warning_of
from fgrecon.core.observation import Observation
from fgrecon.io.boxes import NamedBox
from fgrecon.io.cameras.camera_source import CameraSource
from fgrecon.io.json_fields import read_json
from fgrecon.io.keypoint_file import Instance, refuse_other_file
from fgrecon.io.keypoints import NOT_JSON, parse_any_keypoints, read_any_keypoints
from fgrecon.io.keypoints.records import is_track
from fgrecon.io.kitti_calibration import calibration_beside
from fgrecon.io.track_file import parse_track
from fgrecon.perception.keypoints.detect import CascadeDetection, KeypointCascade, check_box
from fgrecon.perception.protocols import check_category, class_by
from fgrecon.perception.sensor_source import SensorSource

Watch = Callable[[Sequence[Any], str], Iterable[Any]]
"""Goes through some things, and shows under a heading how far that has come."""


def unwatched(items: Sequence[Any], _: str) -> Iterable[Any]:
    """Progress that is not shown."""
    return items


_BATCH = 32  # cars that the networks look at together


@dataclass(frozen=True)
class VehicleTask:
    """A vehicle to reconstruct."""

    instance: Instance  # what is known about it
    camera: Camera  # the camera that took its image
    # (3,) where KITTI's label frame is from the camera's (a labelled point is at X + offset), or None
    label_offset: NDArray[np.float64] | None = None
    box_model: BoxModel | None = None  # what its 2D box encloses, where that is not the run's setting
    evidence: tuple[Evidence, ...] = ()  # what other sensors say of the vehicles of its image

    @property
    def observation(self) -> Observation:
        """What was observed, for drawing; without confidences all points are alike."""
        points, confidence = self.instance.keypoints, self.instance.confidence
        trust = np.ones(len(points)) if confidence is None else confidence
        return Observation(points, trust, self.instance.box, self.instance.covariance)

    @property
    def usable_observation(self) -> Observation | None:
        """What was observed; None where its numbers cannot be used, which the solver says."""
        try:
            return self.instance.observation
        except FgreconError:
            return None


@dataclass(frozen=True)
class ReadTasks:
    """The vehicles of a file."""

    tasks: list[VehicleTask]  # they, at least one
    ignored: tuple[str, ...] = ()  # names of fields that mean nothing to fgrecon
    # why vehicles, or keypoints that the category does not have, were left out
    left_out: tuple[InvalidInputError, ...] = ()

    @property
    def warnings(self) -> list[str]:
        """What was left out, a line each."""
        return [f"Left out: {error}" for error in self.left_out]


def read_tasks(
    path: Path, category: Category, source: CameraSource, names: str | None = None, image: str | None = None
) -> ReadTasks:
    """The vehicles of a file of keypoints, of any format, or of a track.

    Args:
        source: The given camera, which goes before the file's.
        names: What is known of the keypoints' names, or None.
        image: File name of the photograph, whose vehicles are taken; None for all.

    Raises:
        InvalidInputError: The file is malformed, a vehicle has no camera, or states an image of another size than the
            camera's or the picture's.
    """
    refuse_other_file(path)
    offset = None
    ignored: tuple[str, ...] = ()
    left_out: tuple[InvalidInputError, ...] = ()
    data = None if path.suffix.lower() in NOT_JSON else read_json(path)
    of_track = is_track(data)
    if of_track:
        instances, offset = _track_instances(data, path, category)
    else:
        file = (
            read_any_keypoints(path, category, names, image)
            if data is None
            else parse_any_keypoints(data, category, names, image, where=f"{path}: ")
        )
        instances, ignored, left_out = list(file.instances), file.ignored, (*file.left_out, *file.unknown)
    camera_of = cache(source.camera)
    tasks = []
    for instance in instances:
        given, given_offset = camera_of(image if of_track else instance.image or image)
        camera = given or instance.camera
        if camera is None:
            value = f"no camera for instance {instance.name}"
            raise InvalidInputError(
                "intrinsics", value, "Give a camera file or intrinsics (--camera, --intrinsics), or K in the file."
            )
        complete = source.complete(camera, declared=given is None and not of_track)
        if source.crop is None or source.image is not None:
            instance = instance.fitted(complete.image_size, scale=source.scale_to_image)
            if complete.image_size is None:
                complete = replace(complete, image_size=instance.image_size)
        tasks.append(VehicleTask(instance, complete, offset if given is None else given_offset))
    return ReadTasks(tasks, ignored, left_out)


def _track_instances(data: object, path: Path, category: Category) -> tuple[list[Instance], NDArray[np.float64]]:
    """The frames of a track as instances, and its label offset."""
    track = parse_track(data, path.stem, category, where=f"{path}: ")
    nothing = np.full((category.size, 2), np.nan)
    instances = []
    for frame in track.frames:  # each frame is an image of its own, which shows the vehicle once
        instance = Instance(frame.name, nothing, camera=track.camera, image=frame.name)
        if (observation := frame.observation) is not None:
            instance = replace(
                instance, keypoints=observation.keypoints, confidence=observation.confidence, box=observation.box
            )
        instances.append(instance)
    return instances, track.label_offset


def with_classes(tasks: list[VehicleTask], classes: ClassSource | None) -> list[VehicleTask]:
    """The vehicles of a file of keypoints, which is to say of which class each is, or not.

    Raises:
        InvalidInputError: Somebody else is to say it, or the file says it of none.
    """
    if classes is None:
        return tasks
    check_of_file(classes)
    classed = [replace(one, instance=one.instance.classed) for one in tasks]
    if all(one.instance.vehicle_class is None for one in classed):
        fix = "Give vehicles a `kind`, such as car, van, Truck or bus; or leave it out."
        raise InvalidInputError("classes", f"{classes.value}, which no vehicle has", fix)
    return classed


def check_of_file(classes: ClassSource | None) -> None:
    """Refuse classes by networks that do not look, since keypoints are given."""
    if classes not in (None, ClassSource.LABELS):
        raise InvalidInputError("classes", classes.value, "Give images: of keypoints `labels` takes their `kind`.")


@dataclass(frozen=True)
class KeypointRequest:
    """How keypoints are detected in the boxes of an image."""

    category: Category  # category of the shape prior, which the network must have
    weights: Path | None = None  # network, or None for the shipped one
    box_model: BoxModel | None = None  # what the boxes enclose, or None for what their source says
    networks: KeypointCascade | None = None  # the network where it is loaded already, or None
    classes: ClassSource | None = None  # who says of which class the vehicles are, or None


def image_tasks(
    path: Path,
    source: CameraSource,
    boxes: Sequence[NamedBox],
    how: KeypointRequest,
    watch: Watch = unwatched,
    sensors: SensorSource | None = None,
) -> list[VehicleTask]:
    """The vehicles in the boxes of an image, with the keypoints that the networks detect.

    Returns:
        The vehicles. Where no camera is given it is that of KITTI's `calib` beside the image, the photograph's EXIF
        camera, or one of unknown focal length.

    Raises:
        InvalidInputError: A box cannot be used, or there is no network.
    """
    image = source.image
    assert image is not None
    camera, offset = source.camera(path.name)
    if camera is None and source.crop is None and (beside := calibration_beside(path)) is not None:
        camera, offset = beside.camera, beside.label_offset
    if camera is None:
        camera = source.assumed((image.shape[1], image.shape[0]))
    complete = source.complete(camera, declared=False)
    evidence = () if sensors is None else sensors.evidence(path)
    tasks = tasks_in_boxes(image, complete, boxes, how, watch)
    return [replace(task, label_offset=offset, evidence=evidence) for task in tasks]


def tasks_in_boxes(
    image: NDArray[np.uint8],
    camera: Camera,
    boxes: Sequence[NamedBox],
    how: KeypointRequest,
    watch: Watch = unwatched,
) -> list[VehicleTask]:
    """The vehicles in the boxes of an image (H, W, 3) of a camera, with the keypoints that the networks detect.

    Raises:
        InvalidInputError: A box cannot be used, there is no network, or its keypoints are of another category.
    """
    tasks = []
    for item, detection in zip(boxes, detect_in_boxes(image, boxes, how, watch), strict=True):
        observation = detection.observation
        instance = Instance(
            item.name,
            observation.keypoints,
            observation.confidence,
            observation.confidence_midpoint,
            observation.box,
            observation.covariance,
            detection.azimuth,
            track=item.track,
            kind=item.kind,
            score=item.score,
            vehicle_class=class_by(how.classes, item.vehicle_class, detection.kinds),
        )
        tasks.append(VehicleTask(instance, camera, None, how.box_model or item.model))
    return tasks


def detect_in_boxes(
    image: NDArray[np.uint8], boxes: Sequence[NamedBox], how: KeypointRequest, watch: Watch = unwatched
) -> list[CascadeDetection]:
    """The keypoints of the vehicles in some boxes of an image (H, W, 3), a batch at a time.

    Raises:
        InvalidInputError: A box cannot be used, there is no network, or its keypoints are of another category.
    """
    for item in boxes:
        check_box(item.corners, image, f"box {item.name}")
    detector = how.networks or _networks(how.weights)
    check_category(detector, how.category)
    detections: list[CascadeDetection] = []
    for start in watch(range(0, len(boxes), _BATCH), f"Keypoints, {_BATCH} cars at a time"):
        detections += detector(image, [item.corners for item in boxes[start : start + _BATCH]], batch=_BATCH)
    return detections


@lru_cache(maxsize=1)
def _networks(weights: Path | None) -> KeypointCascade:
    """Loaded once for all images of a run."""
    return KeypointCascade(weights)


def input_warnings(tasks: Iterable[VehicleTask], *, detected: bool = False) -> list[str]:
    """What to warn of before vehicles are solved: keypoints in other units, or not where the vehicle is, or the camera.

    Args:
        detected: Whether the keypoints are those that the networks detect, which leaves the camera.
    """
    warnings = InputWarnings()
    for task in tasks:
        if detected:
            warnings.add(task.instance.name, camera_warning_of(task.camera))
        elif (observation := task.usable_observation) is not None:
            warnings.add(task.instance.name, input_warning_of(observation, task.camera))
    return warnings.lines()
