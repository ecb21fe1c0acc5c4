"""Outcome of a refined 3D box: the better box, what changed, and its uncertainty."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from fgrecon.core.arrays import Array
from fgrecon.core.box3d import Box3D
from fgrecon.core.metrics import wrap_angle
from fgrecon.core.reconstruction import Reconstruction
from fgrecon.core.repr import brief_repr


@dataclass(frozen=True, eq=False)
class RefinedBox:
    """A detector's 3D box, and what an image says beside it.

    Attributes:
        given: The box.
        box: The better one; the given one where nothing is known better.
        message: Why it is as it is, in a sentence.
        result: The vehicle that was found; None where it was refused.
        location_covariance: (3, 3) of the better box's location in the camera frame, square metres; None where it is
            the given one.
        yaw_sigma: Standard deviation of its yaw, radians; None likewise.
        size_covariance: (3, 3) of its length, width and height, square metres; None likewise.
    """

    given: Box3D
    box: Box3D
    message: str
    result: Reconstruction | None = None
    location_covariance: Array | None = None
    yaw_sigma: float | None = None
    size_covariance: Array | None = None

    __repr__ = brief_repr

    @property
    def changed(self) -> bool:
        """Whether the box is another than the given one."""
        return self.box is not self.given

    @property
    def moved(self) -> Array:
        """(3,) metres by which it moved in the camera frame."""
        return self.box.location - self.given.location

    @property
    def turn(self) -> float:
        """Radians from -pi to pi by which its yaw changed."""
        return float(wrap_angle(self.box.rotation_y - self.given.rotation_y))

    @property
    def flipped(self) -> bool:
        """Whether its heading was flipped: it faces the other way now."""
        return abs(self.turn) > np.pi / 2.0

    @property
    def facing_probability(self) -> float:
        """How probably the vehicle faces where the box says; NaN where the box is the given one."""
        return float("nan") if self.result is None or not self.changed else self.result.facing_probability

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON: both boxes, what changed, and how sure it is; None where nothing is known."""
        sigmas = (self.location_covariance, self.size_covariance)
        location, size = (None if one is None else np.sqrt(np.diag(one)).tolist() for one in sigmas)
        facing = self.facing_probability
        return {
            "changed": self.changed,
            "message": self.message,
            "status": None if self.result is None else self.result.status.value,
            "given": _plain(self.given),
            "box": _plain(self.box),
            "moved": self.moved.tolist(),
            "turn": self.turn,
            "flipped": self.flipped,
            "facing_probability": facing if np.isfinite(facing) else None,
            "sigma": {"location": location, "rotation_y": self.yaw_sigma, "size": size},
            "location_covariance": None if self.location_covariance is None else self.location_covariance.tolist(),
            "size_covariance": None if self.size_covariance is None else self.size_covariance.tolist(),
        }


def _plain(box: Box3D) -> dict[str, Any]:
    size = None if box.size is None else box.size.tolist()
    return {"location": box.location.tolist(), "rotation_y": float(box.rotation_y), "size": size}
