"""Assignment of detected boxes to labelled ones by their overlap in the image."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.arrays import Array
from fgrecon.io.kitti_files import Objects

MINIMUM_OVERLAP = {"Car": 0.7, "Pedestrian": 0.5, "Cyclist": 0.5}
"""Overlap that a match must exceed, by class."""


def box_overlap(first: Array, second: Array, *, of_first: bool = False) -> Array:
    """Overlap (M, N) of 2D boxes (M, 4) and (N, 4), x1, y1, x2, y2: intersection over union, or over the first."""
    low = np.maximum(first[:, None, :2], second[:, :2])
    high = np.minimum(first[:, None, 2:], second[:, 2:])
    side = np.maximum(high - low, 0.0)
    areas = [np.prod(box[:, 2:] - box[:, :2], axis=1) for box in (first, second)]
    return shared_ratio(side[..., 0] * side[..., 1], areas[0], areas[1], of_first=of_first)


def shared_ratio(inner: Array, first: Array, second: Array, *, of_first: bool) -> Array:
    """Intersections (M, N) over the union of what has these extents (M,) and (N,), or over the first of them."""
    whole = np.broadcast_to(first[:, None], inner.shape) if of_first else first[:, None] + second - inner
    return np.divide(inner, whole, out=np.zeros_like(inner), where=(inner > 0) & (whole > 0))


def match_detections(
    labels: Objects, detections: Objects, least: float = MINIMUM_OVERLAP["Car"], *, kind: str = "Car"
) -> NDArray[np.int64]:
    """For each label the detected car that overlaps it most, by more than KITTI's 0.7 or another; -1 where none does.

    A detection is given to one label at most: pairs are made in the order of their overlap.

    Args:
        labels: M labels.
        detections: What was found.
        least: Overlap that a detection must exceed.
        kind: Of the detections that are taken.
    """
    matched = np.full(len(labels), -1)
    if not len(labels) or not len(detections):
        return matched
    shared = box_overlap(labels.box, detections.box)
    shared[:, [other != kind for other in detections.kind]] = 0.0
    for flat in np.argsort(-shared, axis=None, kind="stable"):
        i, j = np.unravel_index(flat, shared.shape)
        if shared[i, j] <= least:
            break
        if matched[i] < 0 and not (matched == j).any():
            matched[i] = j
    return matched
