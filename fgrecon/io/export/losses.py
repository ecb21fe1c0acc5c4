"""What each kind of file has no place for: the one table that warnings and manual are made of."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from enum import StrEnum

import numpy as np

from fgrecon.core.box3d import box_corners
from fgrecon.core.camera import MIN_DEPTH
from fgrecon.core.geometry import transform
from fgrecon.core.text import counted
from fgrecon.io.export.results import NamedResult


class Part(StrEnum):
    """What a result has that a file may have no place for."""

    BOX = "3D box"
    METRES = "3D box in metres"
    BEHIND = "3D box partly behind the camera"
    LEAN = "lean to the side or ahead"
    KEYPOINTS = "keypoints in the image"
    OUTSIDE = "keypoints outside the image"
    HIDDEN = "hidden keypoints"
    DIGITS = "parts of pixels"
    KIND = "class but car"
    SCORE = "score"
    TRACK = "track"
    VELOCITY = "velocity"
    UNCERTAINTY = "uncertainty"


def _is_behind(item: NamedResult) -> bool:
    corners = transform(item.result.camera_T_object, box_corners(item.result.box_size))
    return bool((corners[:, 2] < MIN_DEPTH).any())


def _is_outside(item: NamedResult) -> bool:
    pixels, size = item.result.pose.wireframe_uv, None if item.camera is None else item.camera.image_size
    return size is not None and bool(((pixels < 0.0) | (pixels > np.subtract(size, 1.0))).any())


_HAS: Mapping[Part, Callable[[NamedResult], bool]] = {
    Part.BEHIND: _is_behind,
    Part.OUTSIDE: _is_outside,
    Part.KIND: lambda item: item.kind is not None and item.kind.lower() != "car",
    Part.SCORE: lambda item: item.score is not None,
    Part.TRACK: lambda item: item.track is not None,
    Part.VELOCITY: lambda item: item.velocity is not None,
    Part.UNCERTAINTY: lambda item: item.result.uncertainty.pose_covariance is not None,
}
"""Whether a vehicle has it; the others all have."""

_OURS = Part.VELOCITY, Part.UNCERTAINTY  # what no annotation tool has
_PLACED = Part.KEYPOINTS, Part.UNCERTAINTY  # what boxes alone are without

LACKS: Mapping[str, tuple[Part, ...]] = {
    "ply": (Part.BOX, Part.KEYPOINTS, Part.KIND, Part.SCORE, Part.TRACK, *_OURS),
    "glb": (Part.BOX, Part.KEYPOINTS, Part.KIND, Part.SCORE, Part.TRACK, *_OURS),
    "csv": (Part.LEAN, Part.VELOCITY),
    "parquet": (Part.VELOCITY,),
    "kitti": (Part.LEAN, Part.TRACK, Part.VELOCITY, *_PLACED),
    "nuscenes": (Part.KIND, Part.TRACK, *_PLACED),
    "nuscenes_tracking": (Part.KIND, *_PLACED),
    "truckscenes": (Part.KIND, Part.TRACK, *_PLACED),
    "zod": (Part.TRACK, Part.VELOCITY, *_PLACED),
    "waymo": (Part.LEAN, Part.KIND, Part.VELOCITY, *_PLACED),
    "argoverse2": (Part.KIND, Part.VELOCITY, *_PLACED),
    "cityscapes3d": (Part.KIND, Part.TRACK, Part.VELOCITY, *_PLACED),
    "openlabel": _OURS,
    "cvat": (Part.METRES, Part.BEHIND, Part.SCORE, Part.TRACK, *_OURS),
    "label_studio": (Part.BOX, Part.HIDDEN, Part.OUTSIDE, Part.TRACK, *_OURS),
    "labelme": (Part.BOX, Part.SCORE, Part.TRACK, *_OURS),
    "scalabel": _OURS,
    "supervisely": (Part.BOX, Part.HIDDEN, Part.OUTSIDE, Part.DIGITS, Part.SCORE, Part.TRACK, *_OURS),
    "datumaro": (Part.METRES, Part.BEHIND, *_OURS),
    "fiftyone": (Part.METRES, Part.BEHIND, *_OURS),
    "coco": (Part.KIND, Part.TRACK, *_OURS),
    "foxglove": (Part.VELOCITY, *_PLACED),
    "vision_msgs": (Part.KEYPOINTS, Part.TRACK, Part.VELOCITY),
    "ros2": (Part.KEYPOINTS, Part.VELOCITY),
    "tum": (),
    "kitti_poses": (),
}
"""By kind of file; without a box there is nothing of it, without keypoints none are hidden."""


def not_written(kind: str, results: Sequence[NamedResult]) -> dict[Part, int]:
    """What a kind of file has no place for, with the number of vehicles that have it.

    Args:
        kind: One of `KINDS`.
        results: Vehicles; those without a pose do not count.
    """
    solved = [item for item in results if item.solved]
    counts = {part: sum(part not in _HAS or _HAS[part](item) for item in solved) for part in LACKS[kind]}
    return {part: count for part, count in counts.items() if count}


def loss_warning(kind: str, lost: Mapping[Part, int]) -> str:
    """What to say of them."""
    listed = ", ".join(f"{part} ({counted(count, 'vehicle')})" for part, count in lost.items())
    return f"{kind} has no place for this, which is not written: {listed}."
