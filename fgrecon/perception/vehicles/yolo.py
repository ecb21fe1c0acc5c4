"""Boxes of cars from the maps of YOLOv4-tiny."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fgrecon.perception.keypoints.decode import sigmoid

__all__ = ["CHANNELS", "HEADS", "Head", "decode"]

Array = NDArray[np.float64]

_CLASSES, _CAR = 80, 2  # of COCO


@dataclass(frozen=True)
class Head:
    """One of the network's outputs.

    Attributes:
        stride: Pixels of the input from one cell to the next.
        anchors: Width and height of the boxes that each cell starts from, pixels of the input.
        stretch: Width of the range of a box's centre, in cells (Darknet's `scale_x_y`).
    """

    stride: int
    anchors: tuple[tuple[float, float], ...]
    stretch: float


HEADS = (
    Head(32, ((81.0, 82.0), (135.0, 169.0), (344.0, 319.0)), 1.05),
    Head(16, ((23.0, 27.0), (37.0, 58.0), (81.0, 82.0)), 1.05),
)
"""Outputs of YOLOv4-tiny, in the order of its layers."""

CHANNELS = tuple(len(head.anchors) * (5 + _CLASSES) for head in HEADS)
"""Of its outputs: for each anchor, the box's four numbers, whether something is there, and the classes."""


def decode(maps: Sequence[NDArray[np.floating]], width: int, least_score: float) -> tuple[Array, Array]:
    """Boxes (M, 4) of cars and their scores (M,) from the network's raw maps, one car in many boxes.

    A box's centre is its cell's centre moved by the stretched sigmoids of the first two numbers, its size the anchor's
    times the exponentials of the next two; its score is the sigmoid of the fifth (something is here) times that of the
    class.

    Args:
        maps: (1, 3 * 85, h, w) of every head, in any order.
        width: Of the network's input, which tells the heads apart, pixels.
        least_score: Boxes below this are left out.

    Returns:
        Boxes as x1, y1, x2, y2 in pixels of the input, its left and upper edge at 0.
    """
    heads = {head.stride: head for head in HEADS}
    boxes, scores = [], []
    for numbers in maps:
        rows, columns = numbers.shape[2:]
        head = heads[width // columns]
        cells = np.asarray(numbers, dtype=np.float64).reshape(len(head.anchors), 5 + _CLASSES, rows, columns)
        score = sigmoid(cells[:, 4]) * sigmoid(cells[:, 5 + _CAR])
        anchor, row, column = np.nonzero(score >= least_score)
        x, y, w, h = cells[anchor, :4, row, column].T
        offset = head.stretch * (sigmoid(np.stack([x, y], axis=1)) - 0.5) + 0.5
        centre = head.stride * (offset + np.stack([column, row], axis=1))
        half = np.exp(np.stack([w, h], axis=1)) * np.array(head.anchors)[anchor] / 2.0
        boxes.append(np.hstack([centre - half, centre + half]))
        scores.append(score[anchor, row, column])
    return np.concatenate(boxes), np.concatenate(scores)
