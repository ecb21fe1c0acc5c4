"""The image input of `fgrecon reconstruct`: boxes, keypoints by the networks, the camera. Imported when it runs."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fgrecon.cli.options import VehicleBoxes
from fgrecon.cli.reconstruct_work import Task
from fgrecon.cli.settings import CameraSource
from fgrecon.cli.terminal import Screen
from fgrecon.core.category import Category
from fgrecon.core.choices import BoxModel
from fgrecon.io.boxes import NamedBox
from fgrecon.io.images import IMAGES
from fgrecon.io.keypoint_file import Instance
from fgrecon.perception.keypoints.detect import CascadeDetection, KeypointCascade, check_box
from fgrecon.perception.protocols import check_category

__all__ = ["find_keypoints", "is_image", "read_image_tasks"]

_BATCH = 32  # cars that the networks look at together


def is_image(path: Path) -> bool:
    """Whether a file is an image, by its ending."""
    return path.suffix.lower() in IMAGES


def find_keypoints(
    image: NDArray[np.uint8], named: Sequence[NamedBox], weights: Path | None, screen: Screen, category: Category
) -> list[CascadeDetection]:
    """The keypoints of the cars in some boxes of an image, a batch at a time.

    Args:
        image: (H, W, 3) pixels.
        named: The boxes.
        weights: Network, or None for the shipped one.
        screen: Where progress is shown.
        category: What the network must find keypoints of.

    Raises:
        InvalidInputError: A box cannot be used, there is no network, or it finds keypoints of another category.
    """
    for item in named:
        check_box(item.corners, image, f"box {item.name}")
    detector = _networks(weights)
    check_category(detector, category)
    found: list[CascadeDetection] = []
    for start in screen.watch(range(0, len(named), _BATCH), f"Keypoints, {_BATCH} cars at a time"):
        found += detector(image, [item.corners for item in named[start : start + _BATCH]], batch=_BATCH)
    return found


@lru_cache(maxsize=1)
def _networks(weights: Path | None) -> KeypointCascade:
    """Loaded once for all images of a run."""
    return KeypointCascade(weights)


def read_image_tasks(
    path: Path,
    image: NDArray[np.uint8],
    source: CameraSource,
    category: Category,
    boxes: VehicleBoxes,
    box_model: BoxModel | None,
    screen: Screen,
) -> list[Task]:
    """The vehicles in the boxes of an image, with the keypoints that the networks find; all in one batch.

    Args:
        path: The image's file.
        image: (H, W, 3) its pixels.
        source: The command line's camera.
        category: Category of the shape prior, which the network must have.
        boxes: Where the cars are, and the network.
        box_model: What the boxes enclose, or None for what their source says.
        screen: Where progress is shown.

    Returns:
        The vehicles, with the photograph's own camera where none is given, or one of unknown focal length.

    Raises:
        InvalidInputError: A box cannot be used, there is no car, or there is no network.
    """
    named = boxes.choose(path, image)
    camera, offset = source.camera(path.name)
    if camera is None:
        camera = source.assumed((image.shape[1], image.shape[0]))
    complete = source.complete(camera, declared=False)
    found = find_keypoints(image, named, boxes.weights, screen, category)
    tasks = []
    for item, detection in zip(named, found, strict=True):
        seen = detection.observation
        instance = Instance(
            item.name,
            seen.keypoints,
            seen.confidence,
            seen.confidence_midpoint,
            seen.box,
            seen.covariance,
            detection.azimuth,
        )
        tasks.append(Task(instance, complete, offset, item.model if box_model is None else box_model))
    return tasks
