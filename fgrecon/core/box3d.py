"""A 3D box of another detector, its error model, and its part inside the image."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.arrays import Array
from fgrecon.core.camera import MIN_DEPTH, Camera
from fgrecon.core.checks import as_finite, own
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.geometry import box_around, yaw_rotation
from fgrecon.core.settings import check_settings, number

_FARTHEST, _LARGEST = 1e5, 1e3  # metres: farther away or larger is no box of anything that a camera sees


@dataclass(frozen=True, eq=False)
class Box3D:
    """A 3D box as detectors give it, to start from.

    Attributes:
        location: (3,) centre of the box's bottom face in the camera frame, metres.
        rotation_y: Yaw about the camera's y axis, radians.
        size: (3,) length, width and height in metres, or None where the prior's size is to be kept.
    """

    location: Array
    rotation_y: float
    size: Array | None = None

    def __post_init__(self) -> None:
        """Check the numbers.

        Raises:
            InvalidInputError: A number is not finite or no box's in metres, or the box is behind the camera or has no
                size.
        """
        location = as_finite("box3d.location", self.location, (3,))
        if np.abs(location).max() > _FARTHEST:
            fix = f"Give metres, at most {_FARTHEST:g}."
            raise InvalidInputError("box3d.location", location.tolist(), fix)
        if location[2] <= MIN_DEPTH:
            raise InvalidInputError("box3d.location", location.tolist(), "Give a box in front of the camera (z > 0).")
        object.__setattr__(self, "location", own(location))
        yaw = float(as_finite("box3d.rotation_y", self.rotation_y, (), "Give an angle in radians."))
        object.__setattr__(self, "rotation_y", yaw)
        if self.size is not None:
            size = as_finite("box3d.size", self.size, (3,))
            if (size <= 0).any() or (size > _LARGEST).any():
                fix = f"Give length, width and height in metres, above zero and at most {_LARGEST:g}."
                raise InvalidInputError("box3d.size", size.tolist(), fix)
            object.__setattr__(self, "size", own(size))

    @property
    def corners(self) -> Array:
        """(8, 3) corners in the camera frame, metres.

        Raises:
            InvalidInputError: The box has no size.
        """
        if self.size is None:
            raise InvalidInputError("box3d.size", None, "Give length, width and height in metres.")
        return box_corners(self.size) @ yaw_rotation(self.rotation_y).T + self.location


def box_corners(size: Array) -> Array:
    """(8, 3) corners of a box of length, width and height standing on the origin; linear in the size.

    Rear before front, bottom before top, right before left, the last changing fastest.
    """
    length, width, height = size
    return np.array(
        [[x * length / 2, -y * height, z * width / 2] for x in (-1, 1) for y in (0, 1) for z in (-1, 1)], dtype=float
    )


@dataclass(frozen=True)
class BoxErrors:
    """How far a detector's 3D boxes are off (1 sigma); the defaults are a monocular detector's.

    Attributes:
        depth: Of the distance, as a share of it.
        bearing: Of where the origin is seen, pixels across and down.
        yaw: Of the yaw of a box whose heading is not flipped, radians.
        size: Of length, width and height, each as a share of it.
        flip_probability: Probability that a box's heading is flipped.
    """

    depth: float = number(0.06, least=1e-3, most=1.0)
    bearing: float = number(2.0, least=0.1, most=1e5)
    yaw: float = number(float(np.deg2rad(10.0)), least=1e-3, most=float(np.pi))
    size: float = number(0.05, least=1e-3, most=1.0)
    flip_probability: float = number(0.05, least=1e-6, most=0.5)

    def __post_init__(self) -> None:
        """Check the settings (`InvalidInputError`)."""
        check_settings(self, "box_errors")


_UNDONE = 1.0  # pixels by which a lens that is undone may miss
_LEAST_SIDE = 1.0  # pixels: what is narrower in the image is not in it
_BOX_EDGES = np.array([(i, j) for i in range(8) for j in range(i + 1, 8) if (i ^ j) in (1, 2, 4)])


def points_ahead(points: Array, edges: NDArray[np.int64]) -> Array:
    """Those of the points (V, 3) in front of the camera, and where edges (E, 2) pass its near plane: (M, 3)."""
    ahead = points[:, 2] >= MIN_DEPTH
    if ahead.all():
        return points
    first, last = points[edges[ahead[edges].sum(axis=1) == 1]].swapaxes(0, 1)
    share = (MIN_DEPTH - first[:, 2:]) / (last[:, 2:] - first[:, 2:])
    return np.concatenate([points[ahead], first + share * (last - first)])


def imaged(camera: Camera, points: Array) -> Array:
    """(M, 2) pixels of points (M, 3); far outside of the image, where the lens cannot be undone, those of a pinhole."""
    ideal = camera.project(points)
    pixels = camera.distort(ideal)
    back, known = camera.ideal_pixels(pixels)
    right = known & (np.abs(back - ideal).max(axis=1) < _UNDONE)
    return np.where(right[:, None], pixels, ideal)


def box_outline(corners: Array, camera: Camera) -> tuple[Array, float] | None:
    """The 2D box (4,) of a 3D box, cut at the near plane and at the image's edges, and the share that was cut off.

    Args:
        corners: (8, 3) in the camera's frame, in the order of `fgrecon.core.box3d.box_corners`.
        camera: The camera, with the size of its image.

    Returns:
        The box and the share of its area outside the image; None where less than a pixel is in it.
    """
    assert camera.image_size is not None
    points = points_ahead(corners, _BOX_EDGES)
    if not len(points):
        return None
    whole = box_around(imaged(camera, points))
    cut = np.clip(whole, 0.0, np.tile(np.subtract(camera.image_size, 1.0), 2))
    if (cut[2:] - cut[:2]).min() < _LEAST_SIDE:
        return None
    return cut, float(1.0 - np.prod(cut[2:] - cut[:2]) / np.prod(whole[2:] - whole[:2]))
