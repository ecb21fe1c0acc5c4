"""Tracks of vehicles with network keypoints and labelled poses, one JSON file per track.

A file holds `K`, `P2` (KITTI's projection of the colour camera), `keypoint_names` and `frames`; each frame holds
`frame`, `box_xyxy`, `keypoints_uv`, `confidence` and `gt` with `location`, `rotation_y` and, where known, `length`,
`width` and `height`. A keypoint without any measurement is `[null, null]`. Labels are in the rectified reference
camera: a labelled point in the frame of the colour camera, which took the image, is X + t2 with t2 = K^-1 P2[:, 3]; the
yaw is the same in both.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.camera import Camera
from fgrecon.core.category import Category
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.observation import Observation
from fgrecon.core.text import whole_text
from fgrecon.io.json_fields import Fields, read_json, within
from fgrecon.io.kitti_calibration import rectified_size

_INTRINSICS_TOLERANCE = 1e-6


@dataclass(frozen=True)
class GroundTruth:
    """Labelled pose."""

    location: NDArray[np.float64]  # (3,) origin of the vehicle (centre of its bottom face) in the label's frame, metres
    rotation_y: float  # yaw about the camera's y axis, radians; 0 when the vehicle faces camera +x
    # (3,) length, width and height, metres, or None where the file does not tell them
    box_size: NDArray[np.float64] | None = None


@dataclass(frozen=True)
class TrackFrame:
    """One vehicle in one image."""

    name: str  # `<track>:<number of the frame>`, shown wherever the frame is mentioned
    # keypoints, confidences and box; None where the frame has no measured keypoint at all
    observation: Observation | None
    truth: GroundTruth  # the labelled pose


@dataclass(frozen=True)
class Track:
    """One vehicle over several images of one camera."""

    name: str  # name of the track (of its file, without the ending)
    camera: Camera  # the colour camera. The files do not tell the image's size
    label_offset: NDArray[np.float64]  # (3,) t2 in metres: a labelled point in the colour camera's frame is X + t2
    frames: tuple[TrackFrame, ...]  # in the order of the file, at least one


def read_track(path: Path, category: Category) -> Track:
    """Read one track.

    Args:
        category: The category whose keypoints the file must hold; they are brought into its order.

    Raises:
        InvalidInputError: The file cannot be read, is not JSON, or a field is missing or unusable; names file, frame
            and field.
    """
    return parse_track(read_json(path), path.stem, category, where=f"{path}: ")


def parse_track(data: Any, name: str, category: Category, where: str = "") -> Track:
    """Check the content of a file and turn it into a track.

    Args:
        category: The category whose keypoints the file must hold.

    Raises:
        InvalidInputError: A field is missing or unusable.
    """
    fields = Fields(data, where)
    name = whole_text(name)  # a file's need not be UTF-8
    matrix = fields.numbers("K", (3, 3))
    projection = fields.numbers("P2", (3, 4))
    if np.abs(projection[:, :3] - matrix).max() > _INTRINSICS_TOLERANCE * np.abs(matrix).max():
        raise InvalidInputError(f"{where}P2", projection.tolist(), "Give P2 = K [I | t2], with the same K.")
    with within(where, {"intrinsics": "K"}):
        camera = Camera(matrix, image_size=rectified_size(matrix))
    names = fields.get("keypoint_names", list)
    if sorted(map(str, names)) != sorted(category.keypoints):
        fix = f"Name each keypoint of {category.name} once: {', '.join(category.keypoints)}."
        raise InvalidInputError(f"{where}keypoint_names", names, fix)
    order = np.array([names.index(keypoint) for keypoint in category.keypoints])
    records = fields.get("frames", list)
    if not records:
        raise InvalidInputError(f"{where}frames", records, "Give at least one frame.")
    label_offset = np.linalg.solve(matrix, projection[:, 3]).astype(np.float64)
    return Track(
        name=name,
        camera=camera,
        label_offset=label_offset,
        frames=tuple(_frame(record, i, name, order, where) for i, record in enumerate(records)),
    )


def _frame(record: Any, position: int, track: str, order: NDArray[np.intp], where: str) -> TrackFrame:
    number = Fields(record, f"{where}frames[{position}].").whole("frame")
    where = f"{where}frame {number}: "
    fields = Fields(record, where)
    count = len(order)
    keypoints = fields.numbers("keypoints_uv", (count, 2), missing=True)[order]
    confidence = fields.numbers("confidence", (count,), missing=True)[order]
    box = fields.numbers("box_xyxy", (4,))
    with within(where, {"keypoints": "keypoints_uv", "box": "box_xyxy"}):
        observation = Observation(keypoints, confidence, box)
    content = fields.get("gt", dict)
    label = Fields(content, f"{where}gt.")
    dimensions = ("length", "width", "height")
    sized = all(name in content for name in dimensions)
    size = np.array([float(label.numbers(name, ())) for name in dimensions]) if sized else None
    return TrackFrame(
        name=f"{track}:{number}",
        observation=observation if observation.measured.any() else None,
        truth=GroundTruth(label.numbers("location", (3,)), float(label.numbers("rotation_y", ())), size),
    )
