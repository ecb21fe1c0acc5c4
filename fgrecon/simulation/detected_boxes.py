"""3D boxes as a detector would give them that errs by so much."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.box3d import Box3D, BoxErrors
from fgrecon.core.camera import Camera
from fgrecon.core.metrics import wrap_angle

__all__ = ["disturbed_boxes"]

_MOST = 3.0  # standard deviations of distance and size: where errors are large a box would be behind the camera


def disturbed_boxes(boxes: Sequence[Box3D], camera: Camera, errors: BoxErrors, rng: np.random.Generator) -> list[Box3D]:
    """True boxes, disturbed: farther or nearer on their rays, seen some pixels aside, turned, some of them round.

    Args:
        boxes: The true boxes.
        camera: The camera.
        errors: How far a detector's are off.
        rng: Source of the errors.
    """
    found = []
    for box in boxes:
        ray = box.location / box.location[2]
        ray[:2] += errors.bearing * rng.standard_normal(2) / camera.matrix.diagonal()[:2]
        depth = box.location[2] * (1.0 + errors.depth * _draw(rng, 1)[0])
        turn = errors.yaw * rng.standard_normal() + np.pi * (rng.random() < errors.turned)
        size = None if box.size is None else box.size * (1.0 + errors.size * _draw(rng, 3))
        found.append(Box3D(ray * depth, float(wrap_angle(box.rotation_y + turn)), size))
    return found


def _draw(rng: np.random.Generator, count: int) -> NDArray[np.float64]:
    drawn: NDArray[np.float64] = np.clip(rng.standard_normal(count), -_MOST, _MOST)
    return drawn
