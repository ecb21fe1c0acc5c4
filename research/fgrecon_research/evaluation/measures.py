"""Measures of research's tables beside those of `fgrecon.core.metrics`, with the same rule for failed instances."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fgrecon.core.checks import as_finite, as_shape
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.metrics import FAILURE_DEGREES

THRESHOLDS = (5, 15, 30)
"""Thresholds of the average orientation precision, degrees."""

Member = TypeVar("Member")


def bands(
    members: Sequence[Member], edges: Sequence[float], value: Callable[[Member], float], unit: str, last: str
) -> dict[str, list[Member]]:
    """Groups from each edge on up to the next, which is in the next group; names are as `15-30 m`.

    Args:
        last: Name of a group that has no end, with `{}` for where it begins.
    """
    found = {}
    for low, high in pairwise(edges):
        name = f"{low:g}-{high:g} {unit}" if np.isfinite(high) else last.format(f"{low:g} {unit}")
        found[name] = [one for one in members if low <= value(one) < high]
    return found


def instances_within(errors: ArrayLike, threshold: float) -> int:
    """Number of errors of at most `threshold` (same unit as the errors)."""
    return int(np.count_nonzero(as_shape("errors", errors, (None,)) <= threshold))


def orientation_precision(errors: ArrayLike, threshold: float) -> float:
    """Average orientation precision (AOP): fraction of instances with an error of at most `threshold`.

    Args:
        errors: (M,) orientation errors, degrees.
        threshold: Degrees.

    Returns:
        Fraction from 0 to 1 of all M instances.

    Raises:
        InvalidInputError: There is no instance.
    """
    count = len(as_shape("errors", errors, (None,)))
    if not count:
        raise InvalidInputError("errors", "no instance", "Give at least one.")
    return instances_within(errors, threshold) / count


def rotation_error(estimated: ArrayLike, true: ArrayLike) -> NDArray[np.float64]:
    """Geodesic distance between rotations: the angle of the rotation that takes one into the other.

    Args:
        estimated: (M, 3, 3) rotation matrices, NaN where the method failed.
        true: (M, 3, 3) true rotation matrices.

    Returns:
        (M,) angle in degrees, from 0 to 180; 180 where the method failed.

    Raises:
        InvalidInputError: The shapes differ or a true rotation is not finite.
    """
    truth = as_finite("true", true, (None, 3, 3))
    relative = np.swapaxes(truth, 1, 2) @ as_shape("estimated", estimated, truth.shape)
    # atan2 of sine and cosine stays exact near 0 and near 180 degrees, where arccos of the trace loses half the digits
    axis = relative[:, (2, 0, 1), (1, 2, 0)] - relative[:, (1, 2, 0), (2, 0, 1)]
    sine, cosine = np.linalg.norm(axis, axis=1), np.trace(relative, axis1=1, axis2=2) - 1.0
    angle = np.degrees(np.arctan2(sine, cosine))
    return np.where(np.isnan(angle), FAILURE_DEGREES, angle)


def keypoint_error(estimated: ArrayLike, true: ArrayLike) -> NDArray[np.float64]:
    """Distance of each estimated 3D keypoint from its true position.

    Args:
        estimated: (..., K, 3) keypoints in metres; NaN where the method failed.
        true: (..., K, 3) true keypoints in the same frame: the object frame to score the shape alone, the camera frame
            to score pose and shape.

    Returns:
        (..., K) distances in metres, infinite where the method failed.

    Raises:
        InvalidInputError: The shapes differ or a true keypoint is not finite.
    """
    truth = np.asarray(true, dtype=np.float64)
    truth = as_finite("true", truth, (*truth.shape[:-1], 3))
    distance: NDArray[np.float64] = np.linalg.norm(as_shape("estimated", estimated, truth.shape) - truth, axis=-1)
    return np.where(np.isnan(distance), np.inf, distance)
