"""Results as lines of KITTI's object evaluation."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fgrecon.core.errors import InvalidInputError
from fgrecon.core.geometry import box_around
from fgrecon.core.metrics import wrap_angle
from fgrecon.io.export.frames import score
from fgrecon.io.export.results import NamedResult
from fgrecon.io.kitti_files import Objects, format_results

__all__ = ["kitti_objects", "kitti_text"]

_UNKNOWN = -1.0


def kitti_text(results: Sequence[NamedResult]) -> str:
    """`kitti_objects` of the vehicles as lines.

    Raises:
        InvalidInputError: The vehicles are of several images, each of which has a file of its own in KITTI.
    """
    return format_results(kitti_objects(results))


def kitti_objects(results: Sequence[NamedResult]) -> Objects:
    """One object per vehicle with a pose: kind, box, size, location in the label frame, yaw and score.

    Where the offset of the label frame is not known, the location is in the camera's.
    The kind is its detector's, else `Car`. The 2D box is the observed one, else that of the projected wireframe. The
    score is its detector's, else the mean weight of the keypoints that the pose shows: it tells how much of what should
    be seen was found where it should be.

    Raises:
        InvalidInputError: The vehicles are of several images, each of which has a file of its own in KITTI.
    """
    solved = [item for item in results if item.solved]
    if len(images := {item.image for item in solved}) > 1:
        told = f"vehicles of {len(images)} images"
        fix = "Write a file for each image (fgrecon.io.export.export): KITTI's lines do not tell it. Or give .csv."
        raise InvalidInputError("results", told, fix)
    rows = [_row(item) for item in solved]
    kinds = [item.kind or "Car" for item in solved]
    return Objects.of_rows(kinds, np.array(rows))


def _row(item: NamedResult) -> list[float]:
    """The numeric columns of a result line."""
    result = item.result
    x, y, z = result.location - (0.0 if item.label_offset is None else item.label_offset)
    length, width, height = result.box_size
    yaw = result.rotation_y
    alpha = float(wrap_angle(yaw - np.arctan2(x, z)))
    box = box_around(result.wireframe_uv) if item.box is None else item.box
    return [_UNKNOWN, _UNKNOWN, alpha, *box, height, width, length, x, y, z, yaw, score(item)]
