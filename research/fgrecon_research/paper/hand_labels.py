"""Keypoints marked by hand on cars of real KITTI images, as tracks of one frame."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from fgrecon.core.category import Category
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.observation import Observation
from fgrecon.io.kitti_calibration import read_calibration
from fgrecon.io.kitti_files import read_labels
from fgrecon.io.track_file import GroundTruth, Track, TrackFrame
from fgrecon_research.training.keypoints.marks import read_street_marks


def read_hand_labels(path: Path, kitti: Path, category: Category) -> list[Track]:
    """Read the marks: visible points have confidence 1, hidden ones hold a guess and are left out.

    Args:
        path: JSON list of cars with `frame`, `object_index` (line of the label file), `regime`, `box_xyxy`,
            `keypoints_uv` and `visible`: see `read_street_marks`.
        kitti: Folder with `training/label_2` and `training/calib`.
        category: The category whose keypoints the file holds, in its order.

    Raises:
        InvalidInputError: The file cannot be read, a field is missing, or a car's label does not exist.
    """
    tracks = []
    for mark in read_street_marks(path, kitti / "training" / "image_2", category.size):
        frame, _, line = mark.name.partition("/")
        index = int(line)
        labels, problems = read_labels(kitti / "training" / "label_2", [frame])
        if problems or not 0 <= index < len(labels[frame]):
            reason = str(problems[0]) if problems else f"{len(labels[frame])} objects"
            raise InvalidInputError(f"{path}: {mark.name}: object_index", index, f"Give a labelled object ({reason}).")
        points = np.where(mark.visible[:, None], mark.keypoints, np.nan)
        observation = Observation(points, mark.visible.astype(np.float64), mark.box) if mark.visible.any() else None
        truth = GroundTruth(labels[frame].location[index], float(labels[frame].rotation_y[index]))
        calibration = read_calibration(kitti / "training" / "calib" / f"{frame}.txt")
        frames = (TrackFrame(f"{frame}:{index}", observation, truth),)
        tracks.append(Track(f"{frame}:{index}", calibration.camera, calibration.label_offset, frames))
    if not tracks:
        raise InvalidInputError(str(path), "no car", "Give a list of marked cars.")
    return tracks
