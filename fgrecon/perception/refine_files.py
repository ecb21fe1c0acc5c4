"""The service behind `fgrecon refine`: 3D boxes in files, refined image by image and written back."""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.box3d import Box3D, BoxErrors
from fgrecon.core.camera import Camera
from fgrecon.core.choices import BoxOrigin
from fgrecon.core.errors import FgreconError, InvalidInputError
from fgrecon.core.input_warnings import summed_up
from fgrecon.core.refined_box import RefinedBox
from fgrecon.io.box_lines import BoxedImage, BoxLine, boxed_images, text_of
from fgrecon.io.cameras.camera_source import CameraSource
from fgrecon.io.datasets import is_data_set, open_sequence
from fgrecon.io.datasets.detections import DetectedBox, Detections, is_submission, read_detections, read_submission
from fgrecon.io.files import behind_links, check_output, write_bytes, write_text
from fgrecon.io.images import read_image
from fgrecon.io.kitti_calibration import calibration_beside, read_calibration
from fgrecon.io.nuscenes import is_nuscenes, open_nuscenes
from fgrecon.io.run_settings import RunSettings
from fgrecon.perception.keypoints.detect import KeypointCascade
from fgrecon.perception.refine import refine_boxes
from fgrecon.perception.sensor_source import SensorSource
from fgrecon.solve.box_origin import contradicted_origin, on_bottom, with_origin
from fgrecon.solve.inputs import as_ground

Boxed = BoxLine | DetectedBox
"""An object of a file with a 3D box."""

KINDS = "Car", "Van"
"""Types of objects that are refined, in capitals or not."""


@dataclass(frozen=True)
class RefineRequest:
    """What holds for all images."""

    errors: BoxErrors  # how far the boxes are off
    settings: RunSettings  # prior, ground, size prior and options
    camera: CameraSource  # the given camera; its `calib` may be a folder with a file for each image
    min_score: float = 0.5  # boxes of a lower score stay as they are
    weights: Path | None = None  # keypoint network, or None for the shipped one
    # what the locations of the files are; those that are written are alike. nuScenes' are known.
    box_origin: BoxOrigin = BoxOrigin.BOTTOM
    sensors: SensorSource | None = None  # other sensors' files, or None

    def __post_init__(self) -> None:
        """Check the score."""
        if not math.isfinite(self.min_score):
            fix = "Give a finite number, less than all scores to refine all."
            raise InvalidInputError("min_score", self.min_score, fix)


@dataclass(frozen=True)
class RefinedImage:
    """An image whose boxes were refined."""

    image: BoxedImage[Boxed]  # it, and its objects
    camera: Camera | None  # the camera; None where the image could not be used
    offset: NDArray[np.float64]  # (3,) where the labels' frame is from the camera's
    boxes: tuple[tuple[Boxed, RefinedBox], ...]  # the vehicles with what became of their boxes
    error: FgreconError | None = None  # why nothing could be done, or None
    box_origin: BoxOrigin = BoxOrigin.BOTTOM  # what the locations of the file are

    @property
    def changed(self) -> dict[int, Any]:
        """How the file has the vehicles whose boxes were refined, by their numbers."""
        return {
            line.number: line.with_box(with_origin(box.box, self.box_origin), self.offset)
            for line, box in self.boxes
            if box.changed
        }


class Refiner:
    """Refines image after image; the network is loaded once.

    Attributes:
        request: What holds for all images.
        contradiction: What to say of the boxes of all images together if they seem to have another origin than is said
            of them: none is refined then.
    """

    def __init__(self, request: RefineRequest, images: Sequence[BoxedImage[Any]]) -> None:
        """Judge the boxes of all images together; no image is read."""
        self.request = request
        together: dict[BoxOrigin, list[Box3D]] = {}
        for image in images:
            with suppress(FgreconError):  # is said when its turn comes
                _, _, boxed = self._boxes(image)
                origin = self._origin(image)
                together.setdefault(origin, []).extend(on_bottom([box for _, box in boxed], origin))
        ground = as_ground(request.settings.ground)
        found = (contradicted_origin(boxes, ground, origin) for origin, boxes in together.items())
        self.contradiction = next(filter(None, found), None)

    def __call__(self, image: BoxedImage[Boxed]) -> RefinedImage:
        """Refine an image's boxes; one that cannot be used keeps them, and says why."""
        origin, sensors = self._origin(image), self.request.sensors
        try:
            camera, offset, boxed = self._boxes(image)
            if self.contradiction is not None:
                kept = [(line, RefinedBox(box, box, f"Unchanged: {self.contradiction}")) for line, box in boxed]
                return RefinedImage(image, camera, offset, tuple(kept), box_origin=origin)
            assert image.image is not None
            pixels = read_image(image.image)
            sized = camera.with_size_of(pixels)
            with summed_up():
                refined = refine_boxes(
                    pixels,
                    [box for _, box in boxed],
                    sized,
                    corners=np.array([line.corners for line, _ in boxed]).reshape(-1, 4),
                    box_errors=self.request.errors,
                    keypoint_detector=self._network,
                    box_origin=origin,
                    evidence=() if sensors is None else sensors.evidence(image.image),
                    **self.request.settings.arguments(),
                )
        except FgreconError as error:
            return RefinedImage(image, None, np.zeros(3), (), error)
        lines = [line for line, _ in boxed]
        return RefinedImage(image, sized, offset, tuple(zip(lines, refined, strict=True)), box_origin=origin)

    def _origin(self, image: BoxedImage[Any]) -> BoxOrigin:
        """What the locations of an image's boxes are."""
        of_lines = all(isinstance(line, BoxLine) for line in image.objects)
        return self.request.box_origin if of_lines else BoxOrigin.BOTTOM

    def _boxes(self, image: BoxedImage[Any]) -> tuple[Camera, NDArray[np.float64], list[tuple[Any, Box3D]]]:
        """The camera of an image, where the labels' frame is from its own, and the boxes that are refined."""
        if image.image is None:
            raise InvalidInputError("images", f"none of {image.name}", "Give its image.")
        camera, offset = self._camera(image.image) if image.camera is None else (image.camera, np.zeros(3))
        boxed = [
            (line, box)
            for line in image.objects
            if line.kind.capitalize() in KINDS
            and line.score >= self.request.min_score
            and (box := line.box(offset)) is not None
        ]
        return camera, offset, boxed

    @cached_property
    def _network(self) -> KeypointCascade:
        return KeypointCascade(self.request.weights)

    def _camera(self, image: Path) -> tuple[Camera, NDArray[np.float64]]:
        """The camera of an image, and where the labels' frame is from its own."""
        given = self.request.camera
        if given.calib is not None and given.calib.is_dir():
            calibration = read_calibration(given.calib / f"{image.stem}.txt")
            return calibration.camera, calibration.label_offset
        camera, offset = given.camera(image.name)
        if camera is None:
            beside = calibration_beside(image)
            if beside is None:
                fix = "Give a calibration, a camera file or intrinsics (--calib, --camera, --intrinsics)."
                raise InvalidInputError("camera", f"none for {image}", fix)
            camera, offset = beside.camera, beside.label_offset
        return given.complete(camera, declared=False), np.zeros(3) if offset is None else offset


class BoxFiles:
    """Files of boxes, and where the refined ones are written: a file for each image of a folder, or one file.

    Attributes:
        images: The images with their boxes.
        targets: The files that are written for the images of a folder.
    """

    def __init__(
        self, boxes: Path, out: Path, images: Sequence[BoxedImage[Any]], submission: Detections | None
    ) -> None:
        """Take what was read; see `open_boxes`."""
        self.images = list(images)
        self._submission, self._out, self._is_folder = submission, out, boxes.is_dir()
        self.targets = [out / image.source.name for image in images] if boxes.is_dir() else []
        self._waiting: list[RefinedImage] = []  # nothing is written as long as no image can be used
        self._refined: list[RefinedImage] = []

    def add(self, refined: RefinedImage) -> None:
        """Take an image; of a folder it is written as soon as one of the images can be used."""
        self._refined.append(refined)
        self._waiting.append(refined)
        if self._is_folder and any(image.error is None for image in self._waiting):
            self._write_waiting()

    def finish(self) -> None:
        """Write what is left.

        Raises:
            FgreconError: No image could be used (it is the first one's error), or a file cannot be written.
        """
        errors = [image.error for image in self._refined if image.error is not None]
        if errors and len(errors) == len(self._refined):
            raise errors[0]
        changed = {number: text for image in self._refined for number, text in image.changed.items()}
        if self._is_folder:
            self._write_waiting()
        elif self._submission is not None:
            write_bytes(self._out, self._submission.content(changed))
        else:
            write_text(self._out, text_of([line for image in self.images for line in image.objects], changed))

    def _write_waiting(self) -> None:
        self._out.mkdir(parents=True, exist_ok=True)
        for refined in self._waiting:
            lines: list[Any] = [*refined.image.objects]
            write_text(self._out / refined.image.source.name, text_of(lines, refined.changed))
        self._waiting.clear()


def open_boxes(boxes: Path, images: Path, out: Path, tables: str | None) -> BoxFiles:
    """Read boxes, and refuse what could not be written after the work.

    Args:
        boxes: KITTI's object lines of an image, a folder of such files, tracking lines, or a submission.
        images: The image, or the folder of images; or a data set with what is meant of it.
        out: File, or for a folder of boxes the folder, of the refined boxes.
        tables: Folder of nuScenes' tables, for its submission; or None.

    Raises:
        InvalidInputError: A file is malformed, there are no tables or no images, or `out` is that of the boxes.
    """
    submission: Detections | None = None
    if is_submission(boxes) and is_data_set(images):
        submission = read_detections(boxes, *open_sequence(images))
    elif is_submission(boxes):
        if tables is None or not is_nuscenes(Path(tables)):
            fix = "Give the folder of nuScenes' tables, such as v1.0-mini, or a data set for the images."
            raise InvalidInputError("camera", tables or "nothing", fix)
        submission = read_submission(boxes, images, open_nuscenes(Path(tables)))
    boxed: list[BoxedImage[Any]] = [*boxed_images(boxes, images)] if submission is None else [*submission.images]
    if behind_links(out) == behind_links(boxes):
        raise InvalidInputError("out", str(out), "Give another place than that of the boxes.")
    if not boxes.is_dir():
        check_output(out)
    elif out.exists() and not out.is_dir():
        raise InvalidInputError("out", str(out), "Give a folder: the boxes are in one.")
    if not any(image.image is not None for image in boxed):
        value = f"none of {boxed[0].name} and {len(boxed) - 1} more"
        raise InvalidInputError("images", value, "Name images as the boxes.")
    return BoxFiles(boxes, out, boxed, submission)
