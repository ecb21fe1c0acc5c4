"""Keypoints marked by hand on cars of real KITTI images, as tracks of one frame."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from fgrecon.core.category import Category
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.observation import Observation
from fgrecon.io.json_fields import Fields, read_json
from fgrecon.io.kitti_calibration import read_calibration
from fgrecon.io.kitti_files import read_labels
from fgrecon.io.track_file import GroundTruth, Track, TrackFrame

__all__ = ["read_hand_labels"]


def read_hand_labels(path: Path, kitti: Path, category: Category) -> list[Track]:
    """Read the marks: visible points have confidence 1, hidden ones hold a guess and are left out.

    Args:
        path: JSON list of cars with `frame`, `object_index` (line of the label file), `box_xyxy`, `keypoints_uv` and
            `visible`.
        kitti: Folder with `training/label_2` and `training/calib`.
        category: The category whose keypoints the file holds, in its order.

    Raises:
        InvalidInputError: The file cannot be read, a field is missing, or a car's label does not exist.
    """
    content = read_json(path)
    if not isinstance(content, list) or not content:
        raise InvalidInputError(str(path), type(content).__name__, "Give a list of marked cars.")
    tracks = []
    for position, record in enumerate(content):
        fields = Fields(record, f"{path}: car {position}: ")
        frame, index = fields.get("frame", str), fields.get("object_index", int)
        labels, problems = read_labels(kitti / "training" / "label_2", [frame])
        if problems or not 0 <= index < len(labels[frame]):
            reason = str(problems[0]) if problems else f"{len(labels[frame])} objects"
            raise InvalidInputError(
                f"{path}: car {position}: object_index", index, f"Give a labelled object ({reason})."
            )
        visible = np.array(fields.get("visible", list), dtype=bool)
        if visible.shape != (category.size,):
            raise InvalidInputError(f"{path}: car {position}: visible", len(visible), f"Give {category.size} values.")
        marks = np.where(visible[:, None], fields.numbers("keypoints_uv", (category.size, 2)), np.nan)
        box = fields.numbers("box_xyxy", (4,))
        observation = Observation(marks, visible.astype(np.float64), box) if visible.any() else None
        label, name = labels[frame], f"{frame}:{index}"
        truth = GroundTruth(label.location[index], float(label.rotation_y[index]))
        calibration = read_calibration(kitti / "training" / "calib" / f"{frame}.txt")
        tracks.append(
            Track(name, calibration.camera, calibration.label_offset, (TrackFrame(name, observation, truth),))
        )
    return tracks
