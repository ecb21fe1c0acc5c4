"""The image input of `fgrecon reconstruct`: boxes, keypoints by the networks, the camera. Imported when it runs."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fgrecon.cli.batch import CameraSource, Task
from fgrecon.cli.common import chosen_boxes
from fgrecon.core.camera import DEFAULT_FIELD_OF_VIEW, Camera
from fgrecon.core.category import Category
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.options import BoxModel
from fgrecon.io.keypoint_file import Instance
from fgrecon.perception.keypoints.detect import KeypointCascade, check_box
from fgrecon.perception.protocols import check_category

__all__ = ["is_image", "read_image_tasks", "refuse_image_options"]

_IMAGES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".webp", ".ppm", ".pgm")


def is_image(path: Path) -> bool:
    """Whether a file is an image, by its ending."""
    return path.suffix.lower() in _IMAGES


def read_image_tasks(
    path: Path,
    image: NDArray[np.uint8],
    source: CameraSource,
    category: Category,
    *,
    box: Sequence[str] | None,
    boxes: Path | None,
    detect: bool,
    weights: Path | None,
    box_model: BoxModel | None,
) -> tuple[list[Task], str | None]:
    """The vehicles in the boxes of an image, with the keypoints that the networks find; all in one batch.

    Args:
        path: The image's file.
        image: (H, W, 3) its pixels.
        source: The command line's camera.
        category: Category of the shape prior, which the network must have.
        box: Boxes as `x1,y1,x2,y2`.
        boxes: File of boxes, or None.
        detect: Whether the image is searched for cars instead.
        weights: Network, or None for the shipped one.
        box_model: What the boxes enclose, or None for what their source says.

    Returns:
        The vehicles, and a warning where the camera had to be assumed.

    Raises:
        InvalidInputError: A box cannot be used, there is no car, or there is no network.
    """
    named = chosen_boxes(path, image, box, boxes, detect=detect)
    for item in named:
        check_box(item.corners, image, f"box {item.name}")
    cascade = KeypointCascade(weights)
    check_category(cascade, category)
    camera, offset = source.camera()
    warning = None
    if camera is None:
        camera = Camera.of_field_of_view(image.shape[1], image.shape[0])
        warning = (
            f"No camera is given: a horizontal field of view of {DEFAULT_FIELD_OF_VIEW:g} degrees is assumed, and "
            "distances are rough. Give --calib or --intrinsics."
        )
    complete = source.complete(camera, declared=False)
    found = cascade(image, [item.corners for item in named])
    tasks = []
    for item, detection in zip(named, found, strict=True):
        seen = detection.observation
        instance = Instance(
            item.name, seen.keypoints, seen.confidence, seen.confidence_midpoint, seen.box, seen.covariance
        )
        tasks.append(Task(instance, complete, offset, detection, item.model if box_model is None else box_model))
    return tasks, warning


def refuse_image_options(box: Sequence[str] | None, boxes: Path | None, weights: Path | None, *, detect: bool) -> None:
    """Refuse what means nothing for a keypoint file.

    Raises:
        InvalidInputError: Boxes, a network or --detect are given.
    """
    for field, value in (("box", box), ("boxes", boxes), ("weights", weights), ("detect", detect)):
        if value:
            raise InvalidInputError(field, str(value), "Give an image instead of keypoints, or leave this out.")
