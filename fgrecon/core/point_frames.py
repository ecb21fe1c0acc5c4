"""Whether points can be where they are said to be: in metres, in the frame of the camera that took the image.

Points of a scan, or of a depth map, have to fall into the image. Where none does, another frame or another unit is the
likely cause, and trying the usual mistakes tells which.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.arrays import Array
from fgrecon.core.camera import MIN_DEPTH, Camera
from fgrecon.core.errors import InvalidInputError

_FARTHEST = 300.0  # metres: the median depth of no scan is larger; millimetres and centimetres are
_SMALLEST = 1.0  # metres: no scan ends nearer; in kilometres, or normalised, all do
_SHARE = 0.02  # of the points fall into the image in the frame of a mistake that explains it,
_TIMES = 20.0  # and so many times more than in the frame in which they are given: whole scans have strays
_LOOKED_AT = 1_000  # points
_MISTAKES: Mapping[str, Array] = {
    "a LiDAR's frame (x forward, y left, z up)": np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]]),
    "a frame with y up and z backward (OpenGL's)": np.diag([1.0, -1.0, -1.0]),
    "a frame with y up": np.diag([1.0, -1.0, 1.0]),
    "a frame with x right, y forward and z up": np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]),
}


def in_image(points: Array, camera: Camera) -> NDArray[np.bool_]:
    """(N,) which of the points (N, 3) in the camera's frame fall into its image; without its size, lie before it."""
    before: NDArray[np.bool_] = points[:, 2] > MIN_DEPTH
    if camera.image_size is None:
        return before
    pixels = np.full((len(points), 2), np.nan)
    pixels[before] = camera.project(points[before])
    inside: NDArray[np.bool_] = before.copy()
    inside[before] = np.all((pixels[before] >= -0.5) & (pixels[before] < np.array(camera.image_size) - 0.5), axis=1)
    return inside


def check_points(points: Array, camera: Camera, field: str = "points") -> None:
    """Refuse points of which none falls into the image, or hardly any though they would, and other units than metres.

    Args:
        points: (N, 3) in the camera's frame, metres.
        camera: The camera; without the size of its image points count that lie before it.
        field: What an error calls them.

    Raises:
        InvalidInputError: None falls into the image, or they are in another unit; says the likely cause.
    """
    some = points[:: max(1, len(points) // _LOOKED_AT)]
    inside = in_image(some, camera)
    if not inside.any() and len(some) < len(points):
        some, inside = points, in_image(points, camera)
    likely, share = _likely_mistake(some, camera) if inside.mean() < _SHARE else ("", 0.0)
    explained = share > _SHARE and share > _TIMES * inside.mean()
    if explained or not inside.any():
        count = "hardly any" if inside.any() else "none"
        raise InvalidInputError(field, f"{len(points)} points, {count} of them in the image", _fix(some, likely))
    median = float(np.median(some[inside, 2]))
    if median > _FARTHEST:
        unit = "millimetres" if median > 10.0 * _FARTHEST else "centimetres"
        fix = f"Give metres; these look like {unit}."
        raise InvalidInputError(field, f"a median depth of {median:.0f} m", fix)


def _likely_mistake(points: Array, camera: Camera) -> tuple[str, float]:
    """The frame in which most of the points (N, 3) fall into the image, and the share that does; none is empty."""
    shares = {name: float(in_image(points @ turn.T, camera).mean()) for name, turn in _MISTAKES.items()}
    likely = max(shares, key=lambda name: shares[name])
    return (likely, shares[likely]) if shares[likely] > _SHARE else ("", 0.0)


def _fix(points: Array, likely: str) -> str:
    """What to give instead of points (N, 3) that do not fall into the image."""
    fix = "Give points in the camera's frame (x right, y down, z forward)"
    if likely:
        return f"{fix}; these look like {likely}: give where that is, or turn them."
    if np.abs(points).max() < _SMALLEST:
        return f"{fix}, in metres: all of these are within {_SMALLEST:g} m."
    if (points[:, 2] <= MIN_DEPTH).all():
        return f"{fix}; all of these are behind it: the motion into its frame may be the inverse one."
    return f"{fix}, and the camera of this image: these are of another place, frame or image."
