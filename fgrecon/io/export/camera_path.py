"""The poses of a camera over a run, as evaluations of odometry read them: lines of TUM and of KITTI."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.errors import InvalidInputError
from fgrecon.io.export.image_info import EVERY, ImageInfo, quaternion

_FIX = "Give a run whose camera moves (--poses, --estimate-motion, a data set), or `world_T_camera` in --images."


def tum_text(images: Mapping[str, ImageInfo]) -> str:
    """Lines `time tx ty tz qx qy qz qw` of world_T_camera in order of time, seconds; without a pose there is none.

    Raises:
        InvalidInputError: No image has a pose, or one with a pose has no time; names it.
    """
    lines = {}
    for name, info, pose in _posed(images):
        if info.timestamp is None:
            raise InvalidInputError(f"images.{name}.timestamp", "nothing", "Give its time, or `--format kitti_poses`.")
        numbers = [*pose[:3, 3].tolist(), *quaternion(pose[:3, :3])]
        lines[info.timestamp] = " ".join(f"{value:.9f}" for value in (info.timestamp, *numbers))
    return "".join(f"{line}\n" for _, line in sorted(lines.items()))


def kitti_poses_text(images: Mapping[str, ImageInfo]) -> str:
    """A line an image: the twelve numbers of the upper rows of world_T_camera.

    Raises:
        InvalidInputError: An image has no pose, which a line of KITTI cannot say; names it.
    """
    lines = [pose[:3].ravel() for _, _, pose in _posed(images, whole=True)]
    return "".join(" ".join(f"{value:.12e}" for value in line) + "\n" for line in lines)


def _posed(
    images: Mapping[str, ImageInfo], *, whole: bool = False
) -> Iterator[tuple[str, ImageInfo, NDArray[np.float64]]]:
    """The images with a pose; with `whole` one without is refused."""
    found = [(name, info, info.world_T_camera) for name, info in images.items() if name != EVERY]
    missing = [name for name, _, pose in found if pose is None]
    if not found or len(missing) == len(found) or (whole and missing):
        raise InvalidInputError(f"images.{missing[0] if missing else EVERY}.world_T_camera", "nothing", _FIX)
    for name, info, pose in found:
        if pose is not None:
            yield name, info, pose
