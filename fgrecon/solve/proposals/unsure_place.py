"""Error of a sensor's extrinsics, which all of its points share, as six variables of an image."""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from fgrecon.core.arrays import Array
from fgrecon.core.evidence import Points
from fgrecon.solve.proposals.search_settings import SETTINGS


@dataclass(frozen=True)
class UnsurePlace:
    """A sensor whose place is known to some radians and metres; points of one place are of one sensor."""

    sigma: tuple[float, float]  # standard deviations of the turn about each axis, and of the shift along it
    origin: tuple[float, ...]  # (3,) where the sensor is about

    @classmethod
    def of(cls, points: Points) -> UnsurePlace | None:
        """That of points, or None where their place is known."""
        return cls(points.place_sigma, tuple(np.asarray(points.origin).tolist())) if any(points.place_sigma) else None

    @property
    def key(self) -> Hashable:
        """The same for all points of one sensor."""
        return self

    @cached_property
    def covariance(self) -> Array:
        """(6, 6) of the variables."""
        turn, shift = self.sigma
        return np.diag([*3 * (turn**2,), *3 * (shift**2,)]) + SETTINGS.points.known_variable_sigma**2 * np.eye(6)

    def off(self, points: Array) -> Array:
        """(M,) by how much points (M, 3) may be off by it, metres."""
        turn, shift = self.sigma
        return np.asarray(np.hypot(turn * np.linalg.norm(points, axis=1), shift))
