"""What the pixels of depth maps have wrong together, as variables of a graph.

    L(v) --- X(v,t) --- depth ---+
    L(w) --- X(w,t) --- depth ---+--- D(t,n) --- prior (what is known of scale and shift)

A depth map is one of the image's, whichever vehicles look at it: its variables are shared by all of them.
"""

from __future__ import annotations

from collections.abc import Sequence

import gtsam

from factors.keys import D
from factors.linear import ZeroPrior
from fgrecon.solve.graph.observation_part import ObservationPart
from fgrecon.solve.proposals.scaled_depth import ScaledDepth

SHARED = "depth_scale"
"""Energy term of what is known of scale and shift."""


class SharedDepths:
    """The variables.

    Attributes:
        maps: The depth map of each, by key.
        priors: What is known of them.
    """

    def __init__(self, observations: Sequence[ObservationPart], *, free: bool) -> None:
        """Number the maps of each image in the order of its observations.

        Args:
            free: Whether what they share are variables at all.
        """
        self.maps: dict[int, ScaledDepth] = {}
        self._keys: dict[tuple[int, int], int] = {}
        for part in observations if free else ():
            for term in part.problem.energy.points:
                if term.depth is None or (part.image, id(term.depth.given)) in self._keys:
                    continue
                key = D(part.image, sum(image == part.image for image, _ in self._keys))
                self._keys[part.image, id(term.depth.given)] = key
                self.maps[key] = term.depth
        self.priors: list[gtsam.NonlinearFactor] = [
            ZeroPrior(key, gtsam.noiseModel.Gaussian.Covariance(depth.covariance)) for key, depth in self.maps.items()
        ]

    def key(self, part: ObservationPart, depth: ScaledDepth | None) -> int | None:
        """Of what an observation shares with others by a map; None where that is no variable."""
        return None if depth is None else self._keys.get((part.image, id(depth.given)))

    def of(self, part: ObservationPart) -> list[int]:
        """Keys of all that an observation shares with others."""
        keys = (self.key(part, term.depth) for term in part.problem.energy.points)
        return [key for key in keys if key is not None]
