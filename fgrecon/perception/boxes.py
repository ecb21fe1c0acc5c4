"""2D boxes of the cars in an image: given, from a file, or found by the detector."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fgrecon.core.checks import as_finite
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.options import BoxModel, Options, checked_options
from fgrecon.io.boxes import FileBoxes, NamedBox, boxes_in
from fgrecon.perception.keypoints.detect import large_enough
from fgrecon.perception.protocols import VehicleDetector, find_vehicles
from fgrecon.perception.vehicles import NanodetVehicleDetector, Vehicles


def boxes_of(
    image: Path,
    given: Sequence[ArrayLike],
    file: Path | None,
    search: NDArray[Any] | None = None,
    size: tuple[int, int] | None = None,
    least_score: float | None = None,
    *,
    scale_to_image: bool = False,
) -> FileBoxes:
    """The boxes given one by one, those of a file, or those that a detector finds.

    Args:
        image: The image's file, by whose name a file of many images is searched.
        given: Boxes x1, y1, x2, y2 in pixels, of the cars' outlines.
        file: File of boxes, or None.
        search: (H, W, 3) the image's pixels, to be searched for cars; or None.
        size: Width and height of the image, which some files' boxes are parts of; or None.
        least_score: Boxes of a lower score are left out; None for what suits their source.
        scale_to_image: Whether boxes of a file are scaled to the image where it states another size of one shape.

    Raises:
        InvalidInputError: Several or none of these are given, or there is no car in this image.
    """
    ways = {"given (--box)": bool(given), "file (--boxes)": file is not None, "search (--detect)": search is not None}
    if sum(ways.values()) != 1:
        flags = " and ".join(way for way, used in ways.items() if used) or "nothing"
        raise InvalidInputError(
            "box", flags, "Give one of them: boxes (--box), a file (--boxes), or an image to search (--detect)."
        )
    if search is not None:
        found = detected_boxes(search, least_score)
        if not found:
            raise InvalidInputError("detect", str(image), "No car was found in it; give its box (`given`, --box).")
        return FileBoxes(found)
    if file is None:
        corners = [as_finite(f"box[{number}]", box, (4,)) for number, box in enumerate(given)]
        return FileBoxes([NamedBox(str(number), box, BoxModel.SURFACE) for number, box in enumerate(corners)])
    place = str(image.absolute().parent / image.stem)
    boxes = boxes_in(file, place, size, least_score, scale_to_image=scale_to_image)
    if not boxes.cars:
        raise InvalidInputError("boxes", str(file), f"Give a file with a car in image {image.stem}; {boxes.left_out}.")
    return boxes


def detected_boxes(image: NDArray[Any], least_score: float | None = None) -> list[NamedBox]:
    """The cars that the detector of the package finds in an image (H, W, 3), by falling score: see `find_boxes`.

    Boxes below `least_score` are left out; None for what suits the detector.

    Raises:
        InvalidInputError: The image is none, or this installation has no detector.
    """
    detector = None if least_score is None else partial(NanodetVehicleDetector(), least_score=least_score)
    found = large_vehicles(image, NanodetVehicleDetector() if detector is None else detector)
    kinds = found.kinds or (None,) * len(found.boxes)
    rows = enumerate(zip(found.boxes, found.scores.tolist(), kinds, strict=True))
    return [NamedBox(str(n), box, BoxModel.DETECTED, score, kind=kind) for n, (box, score, kind) in rows]


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
