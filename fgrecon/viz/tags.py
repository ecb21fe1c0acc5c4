"""Short labels on small plates, placed so that none covers another."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from fgrecon.core.arrays import Array
from fgrecon.core.geometry import box_around
from fgrecon.core.vehicle_mesh import Colour
from fgrecon.viz import style
from fgrecon.viz.marks import unit

Place = tuple[float, float]
_TALL, _WIDE, _MORE = 1.55, 0.68, 0.55  # of a plate, and its width per character, in font sizes
_REACHES = (1.0, 2.0, 3.2, 4.6, 6.5, 9.0)  # how far from what it names, in halves of its size
_MISTAKEN = 3.0  # square points that it would rather cover than seem to name something else


@dataclass(eq=False)
class Plates:
    """The plates of one panel whose axes have their final limits."""

    axes: Any  # the panel
    size: float  # font size in points
    # (4,) rectangles x1, y1, x2, y2 in points that no plate is to cover
    taken: list[Array] = field(default_factory=list)

    def keep_free(self, points: Array) -> None:
        """Let no plate cover the rectangle around points (n, 2) of the axes' own coordinates."""
        self.taken.append(box_around(self._points(points)))

    def put(self, text: str, outline: Array, towards: Iterable[Place], colour: Colour) -> None:
        """Put a plate near what it names, where it covers least; a line leads to it from farther away.

        The plate is sought around the mean of the outline (n, 2), in the axes' own coordinates, in directions (right,
        up) in the order of liking.
        """
        named = self._points(outline)
        at = named.mean(axis=0)
        half = np.array([_MORE + _WIDE * len(text), _TALL]) * self.size / 2
        candidates = [at + half * step * reach for reach in _REACHES for step in np.array(list(towards))]
        low, high = half, self._extent() - half
        candidates = [np.clip(candidate, low, np.maximum(high, low)) for candidate in candidates]
        costs = [
            self._covered(middle, half) + _MISTAKEN * self._nearer_another(middle, named) + 1e-3 * index
            for index, middle in enumerate(candidates)
        ]
        middle = candidates[int(np.argmin(costs))]
        self.taken.append(np.concatenate([middle - half, middle + half]))
        nearest = named[np.linalg.norm(named - middle, axis=1).argmin()]
        if (np.abs(nearest - middle) > 1.3 * half).any():
            line = self._coordinates(np.stack([nearest, middle]))
            self.axes.plot(*line.T, color=unit(style.PAPER), linewidth=1.2, zorder=7)
            self.axes.plot(*line.T, color=unit(colour), linewidth=0.6, zorder=7)
        plate = {"facecolor": unit(style.PAPER), "edgecolor": unit(colour), "linewidth": 0.7, "alpha": 0.9}
        look: dict[str, Any] = {"bbox": {"boxstyle": "round,pad=0.18", **plate}, "color": unit(style.INK), "zorder": 8}
        look |= {"ha": "center", "va": "center_baseline", "fontsize": self.size, "parse_math": False}
        self.axes.text(*self._coordinates(middle[None])[0], text, **look)

    def _covered(self, middle: Array, half: Array) -> float:
        """Square points of what is taken that a plate would cover."""
        taken = np.array(self.taken).reshape(-1, 4)
        shared = np.minimum(taken[:, 2:], middle + half) - np.maximum(taken[:, :2], middle - half)
        return float(np.prod(np.maximum(shared, 0.0), axis=1).sum())

    def _nearer_another(self, middle: Array, named: Array) -> bool:
        """Whether a plate would be nearer to something else than to points (n, 2) of what it names."""
        taken, at = np.array(self.taken).reshape(-1, 4), named.mean(axis=0)
        others = taken[~((taken[:, :2] <= at) & (at <= taken[:, 2:])).all(axis=1)]
        aside = np.maximum(np.maximum(others[:, :2] - middle, middle - others[:, 2:]), 0.0)
        own = np.linalg.norm(named - middle, axis=1).min()
        return bool((np.linalg.norm(aside, axis=1) < own).any())

    def _extent(self) -> Array:
        """(2,) size of the panel in points."""
        return self.axes.get_position().size * self.axes.figure.get_size_inches() * 72.0

    def _points(self, coordinates: Array) -> Array:
        (x1, x2), (y1, y2) = self.axes.get_xlim(), self.axes.get_ylim()
        return (coordinates - (x1, y1)) / (x2 - x1, y2 - y1) * self._extent()

    def _coordinates(self, points: Array) -> Array:
        (x1, x2), (y1, y2) = self.axes.get_xlim(), self.axes.get_ylim()
        return points / self._extent() * (x2 - x1, y2 - y1) + (x1, y1)
