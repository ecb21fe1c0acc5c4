"""Error metrics of estimates: pure functions on arrays, one instance per row.

An instance for which a method fails, refuses or crashes carries NaN as its estimate. It then counts as 180 degrees of
orientation error and as infinitely far away, and stays in every denominator: nothing is ever left out.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fgrecon.core.checks import as_finite, as_shape
from fgrecon.core.errors import InvalidInputError

FAILURE_DEGREES = 180.0
"""Orientation error of an instance without an estimate."""


def wrap_angle(angle: ArrayLike) -> NDArray[np.float64]:
    """Angles in radians brought to [-pi, pi)."""
    return np.mod(np.asarray(angle, dtype=np.float64) + np.pi, 2.0 * np.pi) - np.pi


def orientation_error(estimated: ArrayLike, true: ArrayLike) -> NDArray[np.float64]:
    """Difference of two yaws on the full circle (never modulo 180: front and back are different).

    Args:
        estimated: (M,) yaw of each instance, radians; NaN where the method failed.
        true: (M,) its true yaw, radians.

    Returns:
        (M,) error in degrees, from 0 to 180; 180 where the method failed.

    Raises:
        InvalidInputError: The lengths differ or a true yaw is not finite.
    """
    truth = as_finite("true", true, (None,))
    difference = np.degrees(np.abs(wrap_angle(as_shape("estimated", estimated, truth.shape) - truth)))
    return np.where(np.isnan(difference), FAILURE_DEGREES, difference)


def average_precision(scores: ArrayLike, right: ArrayLike, total: int) -> float:
    """Average precision: area below the curve of precision over recall, each precision the largest from there on.

    Of a keypoint's places in many vehicles, right where they are within a tolerance, it is the APK of Yang and Ramanan.

    Args:
        scores: (M,) of what was found, the surest largest; those that are equal count together.
        right: (M,) whether each is right.
        total: How many there are to be found.

    Returns:
        Fraction from 0 to 1; NaN where there is nothing to be found.

    Raises:
        InvalidInputError: The lengths differ, a score is not finite, or more are right than there are.
    """
    sure = as_finite("scores", scores, (None,))
    order = np.argsort(-sure, kind="stable")
    hits = np.cumsum(as_shape("right", right, sure.shape)[order])
    if len(hits) and hits[-1] > total:
        raise InvalidInputError("right", int(hits[-1]), f"Give at most one for each of the {total} to be found.")
    if total == 0:
        return float("nan")
    last = np.flatnonzero(np.append(np.diff(sure[order]) != 0.0, True)[: len(order)])  # of each score
    precision = np.maximum.accumulate((hits[last] / (last + 1.0))[::-1])[::-1]
    return float(np.diff(hits[last], prepend=0.0) @ precision / total)


def translation_error(estimated: ArrayLike, true: ArrayLike) -> NDArray[np.float64]:
    """Euclidean distance between estimated and true object origin.

    Args:
        estimated: (M, 3) origins in metres, NaN where the method failed; same frame as the true ones.
        true: (M, 3) true origins, metres.

    Returns:
        (M,) distance in metres; infinite where the method failed, so that a median counts it as worst.

    Raises:
        InvalidInputError: The shapes differ or a true origin is not finite.
    """
    truth = as_finite("true", true, (None, 3))
    distance: NDArray[np.float64] = np.linalg.norm(as_shape("estimated", estimated, truth.shape) - truth, axis=1)
    return np.where(np.isnan(distance), np.inf, distance)


def hausdorff_distance(first: ArrayLike, second: ArrayLike) -> float:
    """Symmetric Hausdorff distance between two sets of points, such as the keypoints of two wireframes.

    Args:
        first: (P, 3) points, metres.
        second: (Q, 3) points in the same frame, metres.

    Returns:
        The largest distance in metres from a point of either set to the nearest point of the other.

    Raises:
        InvalidInputError: A set is empty, of the wrong shape or not finite.
    """
    from scipy.spatial import cKDTree  # on use: importing the metrics alone stays fast

    sets: Sequence[NDArray[np.float64]] = (
        as_finite("first", first, (None, 3)),
        as_finite("second", second, (None, 3)),
    )
    for field, points in zip(("first", "second"), sets, strict=True):
        if not len(points):
            raise InvalidInputError(field, "no points", "Give at least one point.")
    a, b = sets
    return float(max(cKDTree(b).query(a)[0].max(), cKDTree(a).query(b)[0].max()))
