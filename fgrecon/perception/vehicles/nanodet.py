"""Boxes of cars from the maps of NanoDet-g."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from fgrecon.perception.keypoints.decode import sigmoid

__all__ = ["CHANNELS", "CLASSES", "DISTANCES", "MEAN", "STRIDES", "decode"]

Array = NDArray[np.float64]

MEAN = (123.675, 116.28, 103.53)
"""Red, green and blue that it takes for nothing, from 0 to 255."""

STRIDES = (8, 16, 32)
"""Pixels of the input from one cell to the next, of each of its outputs."""

CLASSES, DISTANCES = 80, 11
"""Of COCO; and of a box's edge from the cell's centre, 0 to 10 cells."""

CHANNELS = (CLASSES + 4 * DISTANCES,) * len(STRIDES)
"""Of its outputs: classes, then distances to the left, upper, right and lower edge."""

_CAR = 2
_SHARPNESS, _OFFSET = 3.4, 1.25  # of the score, fitted on KITTI's 19 images


def decode(maps: Sequence[NDArray[np.floating]], width: int, least_score: float) -> tuple[Array, Array]:
    """Boxes (M, 4) of cars and their scores (M,) from the network's raw maps, one car in many boxes.

    The distance of each edge from its cell's centre is the mean of a distribution over 0 to 10 cells. The class's
    number tells both, whether it is a car and how well the box fits; the score is a logistic regression on it.

    Args:
        maps: (1, 80 + 4 * 11, h, w) of every stride, in any order.
        width: Of the network's input, which tells the strides apart, pixels.
        least_score: Boxes below this are left out.

    Returns:
        Boxes as x1, y1, x2, y2 in pixels of the input, its left and upper edge at 0.
    """
    boxes, scores = [], []
    for numbers in maps:
        stride = width // numbers.shape[3]
        score = sigmoid(_SHARPNESS * np.asarray(numbers[0, _CAR], dtype=np.float64) + _OFFSET)
        row, column = np.nonzero(score >= least_score)
        logits = np.asarray(numbers[0, CLASSES:, row, column], dtype=np.float64).reshape(-1, 4, DISTANCES)
        share = np.exp(logits - logits.max(axis=2, keepdims=True))
        left_up, right_down = np.split(share @ np.arange(DISTANCES) / share.sum(axis=2), 2, axis=1)
        centre = np.stack([column, row], axis=1) + 0.5
        boxes.append(stride * np.hstack([centre - left_up, centre + right_down]))
        scores.append(score[row, column])
    return np.concatenate(boxes), np.concatenate(scores)
