"""2D boxes of the cars in an image: given, from a file, or found by the detector."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fgrecon.core.checks import as_finite
from fgrecon.core.choices import ClassSource
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.evidence import VehicleClass
from fgrecon.core.geometry import box_overlaps
from fgrecon.core.options import BoxModel, Options, checked_options
from fgrecon.io.boxes import FileBoxes, NamedBox, boxes_in, names_images
from fgrecon.perception.keypoints.detect import large_enough
from fgrecon.perception.protocols import VehicleDetector, find_vehicles
from fgrecon.perception.vehicles import NanodetVehicleDetector, Vehicles

_SAME_VEHICLE = 0.5  # intersection over union from which on a detected box is about the vehicle of another


@dataclass(frozen=True)
class GivenBoxes:
    """Where the boxes of images' cars are from; where nothing is given, the detector finds them."""

    given: Sequence[ArrayLike] = ()  # boxes x1, y1, x2, y2 in pixels, of the cars' outlines
    file: Path | None = None  # file of boxes, or a folder of such, as `fgrecon.io.boxes.boxes_in` takes it; or None
    detect: bool = False  # whether the detector is named, which only goes without the others
    least_score: float | None = None  # boxes of a lower score are left out; None for what suits their source

    def __post_init__(self) -> None:
        """Refuse several sources."""
        ways = {
            "given (--box)": bool(self.given),
            "file (--boxes)": self.file is not None,
            "detector (--detect)": self.detect,
        }
        if sum(ways.values()) > 1:
            flags = " and ".join(way for way, used in ways.items() if used)
            fix = "Give one of them: boxes (--box), a file (--boxes), or nothing, which lets the detector look."
            raise InvalidInputError("box", flags, fix)

    def check_images(self, count: int) -> None:
        """Refuse a file that says of no box which image it is in, where there are several images."""
        if self.file is not None and count > 1 and not names_images(self.file):
            fix = "Give a folder with a file for each, or boxes that name their image (COCO, CSV, lines of detections)."
            raise InvalidInputError("boxes", f"{self.file}, of one image, for {count} images", fix)

    def check_classes(self, classes: ClassSource | None) -> None:
        """Refuse classes by who labelled the vehicles where nobody did."""
        if classes is ClassSource.LABELS and self.file is None:
            fix = "Give a file of boxes that have a class (--boxes); what the detector says is `detected`."
            raise InvalidInputError("classes", classes.value, fix)

    def of_image(
        self, image: Path, pixels: NDArray[Any], *, scale_to_image: bool = False, classes: ClassSource | None = None
    ) -> FileBoxes:
        """The cars of an image.

        Args:
            image: The image's file, by whose name a file of many images is searched.
            pixels: (H, W, 3).
            scale_to_image: Whether boxes of a file are scaled to the image where it states another size of one shape.
            classes: Who says of which class the vehicles are: those of a file that are no cars are taken then as well.

        Raises:
            InvalidInputError: A box or the file cannot be used, or there is no car in this image.
        """
        self.check_classes(classes)
        if self.file is not None:
            boxes = self.in_file(image, pixels, scale_to_image=scale_to_image, classes=classes)
            if not boxes.cars:
                fix = f"Give a file with a car in image {image.stem}; {boxes.left_out}."
                raise InvalidInputError("boxes", str(self.file), fix)
            return replace(boxes, cars=_classed(boxes.cars, pixels, classes))
        if self.given:
            corners = [as_finite(f"box[{number}]", box, (4,)) for number, box in enumerate(self.given)]
            named = [NamedBox(str(number), box, BoxModel.SURFACE) for number, box in enumerate(corners)]
            return FileBoxes(_classed(named, pixels, classes))
        found = detected_boxes(pixels, self.least_score)
        if not found:
            raise InvalidInputError("detect", str(image), "No car was found in it; give its box (`given`, --box).")
        return FileBoxes(found)

    def in_file(
        self, image: Path, pixels: NDArray[Any], *, scale_to_image: bool = False, classes: ClassSource | None = None
    ) -> FileBoxes:
        """What the file has for an image, which may be no car; the arguments are those of `of_image`."""
        assert self.file is not None
        place, size = str(image.absolute().parent / image.stem), (pixels.shape[1], pixels.shape[0])
        how = {"scale_to_image": scale_to_image, "all_classes": classes is not None}
        return boxes_in(self.file, place, size, self.least_score, **how)


def detected_boxes(
    image: NDArray[Any], least_score: float | None = None, detector: NanodetVehicleDetector | None = None
) -> list[NamedBox]:
    """The cars that the detector of the package finds in an image (H, W, 3), by falling score: see `find_boxes`.

    Args:
        least_score: Boxes below are left out; None for what suits the detector.
        detector: It, where it is loaded already.

    Raises:
        InvalidInputError: The image is none, or this installation has no detector.
    """
    detector = NanodetVehicleDetector() if detector is None else detector
    found = large_vehicles(image, detector if least_score is None else partial(detector, least_score=least_score))
    kinds = found.kinds or ("Car",) * len(found.boxes)  # what it looks for
    classes = found.classes or (None,) * len(found.boxes)
    rows = enumerate(zip(found.boxes, found.scores.tolist(), kinds, classes, strict=True))
    return [NamedBox(str(n), box, BoxModel.DETECTED, score, None, k, one) for n, (box, score, k, one) in rows]


def _classed(boxes: list[NamedBox], image: NDArray[Any], classes: ClassSource | None) -> list[NamedBox]:
    """Boxes of an image with the detector's classes, where it is to say them."""
    return with_detected_classes(boxes, image, NanodetVehicleDetector()) if classes is ClassSource.DETECTED else boxes


def with_detected_classes(boxes: list[NamedBox], image: NDArray[Any], detector: VehicleDetector) -> list[NamedBox]:
    """Boxes of an image (H, W, 3) of the classes that a detector says; see `classes_at`."""
    classes = classes_at(np.array([one.corners for one in boxes]).reshape(-1, 4), image, detector)
    return [replace(one, vehicle_class=known) for one, known in zip(boxes, classes, strict=True)]


def classes_at(boxes: NDArray[np.float64], image: NDArray[Any], detector: VehicleDetector) -> list[VehicleClass | None]:
    """Of which class the vehicles in boxes (N, 4) are by the detected box that is most like each; None without one.

    The package's detector is asked about these boxes, also where it would find no car itself.

    Raises:
        InvalidInputError: The image is none, or the detector returns something else.
    """
    if isinstance(detector, NanodetVehicleDetector):
        return [*detector.classes_of(image, boxes)]
    found = find_vehicles(detector, image)
    if not (found.classes and len(boxes)):
        return [None] * len(boxes)
    alike = box_overlaps(boxes, found.boxes)
    best = zip(alike.argmax(axis=1).tolist(), alike.max(axis=1), strict=True)
    return [found.classes[at] if most > _SAME_VEHICLE else None for at, most in best]


def for_detected(options: Options | None) -> Options:
    """Settings for boxes that the package's detector found: an outline is one as it draws it."""
    options = checked_options(options)
    if options.box.model is not BoxModel.SURFACE:
        return options
    return replace(options, box=replace(options.box, model=BoxModel.DETECTED))


def find_boxes(image: NDArray[np.uint8], detector: VehicleDetector | None = None) -> NDArray[np.float64]:
    """(N, 4) boxes of `large_vehicles`, by a detector or by that of the package.

    Args:
        image: (H, W, 3) RGB.
        detector: What finds them; None for the detector of the package.

    Raises:
        InvalidInputError: The image is none, the detector returns something else, or this installation has none.
    """
    return large_vehicles(image, NanodetVehicleDetector() if detector is None else detector).boxes


def large_vehicles(image: NDArray[np.uint8], detector: VehicleDetector) -> Vehicles:
    """The vehicles that a detector finds in an image (H, W, 3), in its order.

    Those under 8 pixels, in which there are no keypoints to be found, are left out.

    Raises:
        InvalidInputError: The image is none, or the detector returns something else.
    """
    found = find_vehicles(detector, image)
    large = np.flatnonzero(large_enough(found.boxes))
    return found.take(large)
