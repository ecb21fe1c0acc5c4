"""From which direction a vehicle is seen: what a pose costs by the directions that a detector thinks probable.

Keypoints of a car seen from ahead and of one seen from behind can look much alike: both poses are minima of the energy,
and the wrong one may be a few nats lower. This term decides between them. Within one minimum the keypoints tell the
direction far better, so it has no gradient.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fgrecon.core.detection import at_direction
from fgrecon.core.geometry import view_azimuth
from fgrecon.solve.proposals.terms import Hypotheses, Quadratic

__all__ = ["DirectionTerm", "direction_penalty"]

Array = NDArray[np.float64]

_DOUBT = 0.05
"""Probability that the directions mean nothing: none costs more than its logarithm and a little."""


@dataclass(frozen=True)
class DirectionTerm:
    """Minus the logarithm of a direction's probability, 0 for the most probable one.

    Attributes:
        azimuth: (A,) probability of each direction, as in `fgrecon.core.observation.Observation`.
    """

    azimuth: Array

    @property
    def probability(self) -> Array:
        """(A,) probability of each direction, relative to the greatest, with what the detector may be wrong by."""
        probability = (1.0 - _DOUBT) * self.azimuth + _DOUBT / len(self.azimuth)
        relative: Array = probability / probability.max()
        return relative

    def energy(self, h: Hypotheses) -> Array:
        """(H,) energies of the hypotheses, nats."""
        here = at_direction(self.probability, view_azimuth(h.rotation, h.translation))
        return np.asarray(-np.log(here), dtype=np.float64)

    def add(self, total: Quadratic, h: Hypotheses) -> None:
        """Add this term: energies alone."""
        total.energy += self.energy(h)


def direction_penalty(azimuth: Array | None, camera_T_object: ArrayLike) -> float:
    """What a pose (4, 4) costs by the directions (A,), nats; 0 where none are given."""
    if azimuth is None:
        return 0.0
    pose = np.asarray(camera_T_object, dtype=np.float64)
    return float(DirectionTerm(azimuth).energy(Hypotheses(pose[None, :3, :3], pose[None, :3, 3], np.zeros((1, 0))))[0])
