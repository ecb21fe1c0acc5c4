"""The image input of `fgrecon reconstruct`: boxes, keypoints by the networks, the camera. Imported when it runs."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fgrecon.cli.batch import CameraSource, Task
from fgrecon.cli.options import BoxOptions
from fgrecon.cli.terminal import Screen
from fgrecon.core.camera import Camera
from fgrecon.core.options import BoxModel
from fgrecon.io.boxes import NamedBox
from fgrecon.io.keypoint_file import Instance
from fgrecon.perception.keypoints.detect import Detection, Detector, check_box

__all__ = ["DEFAULT_FIELD_OF_VIEW", "default_camera", "find_keypoints", "is_image", "read_image_tasks"]

DEFAULT_FIELD_OF_VIEW = 60.0
"""Horizontal field of view in degrees where nothing is known about the camera: distances are then rough."""

_BATCH = 32  # cars that the networks look at together
_IMAGES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".webp", ".ppm", ".pgm")


def is_image(path: Path) -> bool:
    """Whether a file is an image, by its ending."""
    return path.suffix.lower() in _IMAGES


def default_camera(width: int, height: int) -> Camera:
    """A camera with the default field of view, looking straight at the middle of an image of that many pixels."""
    focal = width / 2 / np.tan(np.radians(DEFAULT_FIELD_OF_VIEW) / 2)
    return Camera.of([focal, focal, (width - 1) / 2, (height - 1) / 2])


def find_keypoints(
    image: NDArray[np.uint8], named: Sequence[NamedBox], weights: Path | None, screen: Screen
) -> list[Detection]:
    """The keypoints of the cars in some boxes of an image, a batch at a time.

    Args:
        image: (H, W, 3) pixels.
        named: The boxes.
        weights: Network, or None for the shipped one.
        screen: Where progress is shown.

    Raises:
        InvalidInputError: A box cannot be used, or there is no network.
    """
    for item in named:
        check_box(item.corners, image, f"box {item.name}")
    detector = Detector(weights)
    found: list[Detection] = []
    for start in screen.watch(range(0, len(named), _BATCH), f"Keypoints, {_BATCH} cars at a time"):
        found += detector(image, [item.corners for item in named[start : start + _BATCH]], batch=_BATCH)
    return found


def read_image_tasks(
    path: Path,
    image: NDArray[np.uint8],
    source: CameraSource,
    boxes: BoxOptions,
    box_model: BoxModel | None,
    screen: Screen,
) -> tuple[list[Task], str | None]:
    """The vehicles in the boxes of an image, with the keypoints that the networks find; all in one batch.

    Args:
        path: The image's file.
        image: (H, W, 3) its pixels.
        source: The command line's camera.
        boxes: Where the cars are, and the network.
        box_model: What the boxes enclose, or None for what their source says.
        screen: Where progress is shown.

    Returns:
        The vehicles, and a warning where the camera had to be assumed.

    Raises:
        InvalidInputError: A box cannot be used, there is no car, or there is no network.
    """
    named = boxes.choose(path, image)
    camera, offset = source.camera()
    warning = None
    if camera is None:
        camera = default_camera(image.shape[1], image.shape[0])
        warning = (
            f"No camera is given: a horizontal field of view of {DEFAULT_FIELD_OF_VIEW:g} degrees is assumed, and "
            "distances are rough. Give --calib or --intrinsics."
        )
    complete = source.complete(camera, declared=False)
    found = find_keypoints(image, named, boxes.weights, screen)
    tasks = []
    for item, detection in zip(named, found, strict=True):
        seen = detection.observation
        instance = Instance(item.name, seen.keypoints, seen.confidence, seen.box, seen.covariance)
        tasks.append(Task(instance, complete, offset, detection, item.model if box_model is None else box_model))
    return tasks, warning
