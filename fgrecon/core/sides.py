"""Which side of the vehicle keypoints and edges lie on, and the colours of the sides wherever they are drawn."""

from __future__ import annotations

from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

__all__ = ["SIDE_COLOURS", "SURFACE", "Colour", "Side", "edge_sides", "keypoint_sides"]

_MEDIAL = 1e-3  # metres from the medial plane

Colour = tuple[int, int, int]


class Side(StrEnum):
    """The vehicle's own side that a keypoint or an edge lies on."""

    LEFT = "left"
    RIGHT = "right"
    ACROSS = "across"
    """On the medial plane, or an edge from one side to the other."""


SIDE_COLOURS: dict[Side, Colour] = {Side.LEFT: (0, 114, 178), Side.RIGHT: (213, 94, 0), Side.ACROSS: (140, 140, 140)}
"""Blue is the vehicle's left, vermilion its right, grey what joins them."""
SURFACE: Colour = (196, 204, 214)
"""The reconstructed surface."""


def keypoint_sides(names: tuple[str, ...], wireframe: NDArray[np.float64]) -> tuple[Side, ...]:
    """Side of each of K keypoints: from names that begin with `left` or `right`, else from z (left is positive).

    Args:
        names: K keypoint names.
        wireframe: (K, 3) keypoints in the object frame, metres.
    """

    def side(name: str, z: float) -> Side:
        for value in (Side.LEFT, Side.RIGHT):
            if name.startswith(value.value):
                return value
        if not np.isfinite(z) or abs(z) < _MEDIAL:
            return Side.ACROSS
        return Side.LEFT if z > 0 else Side.RIGHT

    return tuple(side(name, z) for name, z in zip(names, wireframe[:, 2], strict=True))


def edge_sides(edges: NDArray[np.int64], sides: tuple[Side, ...]) -> dict[Side, NDArray[np.int64]]:
    """The edges (E, 2) split by side, each (E_side, 2): both ends on one side, or across."""
    split: dict[Side, list[NDArray[np.int64]]] = {side: [] for side in Side}
    for edge in edges:
        a, b = sides[edge[0]], sides[edge[1]]
        split[a if a == b else Side.ACROSS].append(edge)
    return {side: np.array(group, dtype=np.int64).reshape(-1, 2) for side, group in split.items()}
