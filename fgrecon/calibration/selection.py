"""Selection of the vehicles to annotate, and why the others are left out."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.errors import InvalidInputError
from fgrecon.io.kitti_drives import DriveFrame


class Reason(StrEnum):
    """Why an object has no keypoints. That the network disagrees is none: boxes are the truth."""

    DRAWN_OVER = "something is drawn over it"
    SMALL = "too small"
    OCCLUDED = "too occluded"
    TRUNCATED = "too much of it outside the image"
    OUTSIDE = "its 2D box is not in the image"
    NO_BOX = "no 3D box"
    """Neither is there one nor was there word of how to do without: see `fgrecon_research.annotation.unboxed`."""
    FEW_POINTS = "too few keypoints found"
    NO_MINIMUM = "no minimum of the graph"
    UNSURE = "not sure"
    """It has no 3D box, and its own reconstruction is not one to trust, or may face the other way."""


@dataclass(frozen=True)
class LeftOut:
    """An object of a selected kind without keypoints, and why."""

    frame: int  # number of the image
    track: int  # number of the vehicle
    reason: Reason  # why
    kind: str  # as labelled


@dataclass(frozen=True)
class Selection:
    """Which objects are annotated."""

    kinds: tuple[str, ...] = ("Car", "Van")
    height: float = 25.0  # least height of the 2D box, pixels
    occlusion: int = 2  # most of KITTI's grade
    truncation: float = 0.5  # largest share outside the image

    def __post_init__(self) -> None:
        """Check the limits.

        Raises:
            InvalidInputError: There is no kind, or a limit lets nothing through or is no number.
        """
        if not self.kinds:
            raise InvalidInputError("selection.kinds", "none", "Give at least one kind, such as Car.")
        if not self.height >= 0.0:
            raise InvalidInputError("selection.height", self.height, "Give pixels, from 0.")
        if self.occlusion < 0:
            raise InvalidInputError("selection.occlusion", self.occlusion, "Give KITTI's grade, from 0.")
        if not 0.0 <= self.truncation <= 1.0:
            raise InvalidInputError("selection.truncation", self.truncation, "Give a share from 0 to 1.")

    def judge(self, frame: DriveFrame) -> tuple[NDArray[np.intp], list[LeftOut]]:
        """A frame's objects of the selected kinds: indices of those to annotate, and why the others are not.

        What is unknown (-1) of truncation and occlusion speaks against none.
        """
        o = frame.objects
        rows, left = [], []
        for row, kind in enumerate(o.kind):
            if kind not in self.kinds:
                continue
            reason = None
            if not frame.usable[row]:
                reason = Reason.DRAWN_OVER
            elif o.box[row, 3] - o.box[row, 1] < self.height:
                reason = Reason.SMALL
            elif o.occlusion[row] > self.occlusion:
                reason = Reason.OCCLUDED
            elif o.truncation[row] > self.truncation:
                reason = Reason.TRUNCATED
            if reason is None:
                rows.append(row)
            else:
                left.append(LeftOut(frame.number, int(frame.tracks[row]), reason, kind))
        return np.array(rows, dtype=np.intp), left
