"""Errors that all points of a sensor share, as variables of the graph: depth maps' scale, a LiDAR's extrinsics.

    L(v) --- X(v,t) --- points ---+
    L(w) --- X(w,t) --- points ---+--- D(t,n) --- prior (how sure scale and shift, or the place, are)

A sensor is one of the image's, whichever vehicles it sees: its variables are shared by all of them.
"""

from __future__ import annotations

from collections.abc import Hashable, Sequence

import gtsam
import numpy as np

from factors.keys import D
from factors.linear import ZeroPrior
from fgrecon.solve.graph.observation_part import ObservationPart
from fgrecon.solve.proposals.point_term import PointTerm
from fgrecon.solve.proposals.scaled_depth import ScaledDepth
from fgrecon.solve.proposals.unsure_place import UnsurePlace

DEPTH, PLACE = "depth_scale", "sensor_place"
"""Energy terms of what is known of scale and shift, and of a sensor's place."""


class SharedErrors:
    """The variables.

    Attributes:
        known: What is known of each, by key.
    """

    def __init__(self, observations: Sequence[ObservationPart], *, free: bool) -> None:
        """Number those of each image in the order of its observations.

        Args:
            free: Whether what they share are variables at all.
        """
        self.known: dict[int, ScaledDepth | UnsurePlace] = {}
        self._keys: dict[tuple[int, Hashable], int] = {}
        shares: dict[int, float] = {}
        for part in observations if free else ():
            for term in part.problem.energy.points:
                if term.shared is None or (part.image, term.shared.key) in self._keys:
                    continue
                key = D(part.image, sum(image == part.image for image, _ in self._keys))
                self._keys[part.image, term.shared.key] = key
                self.known[key], shares[key] = term.shared, part.share
        self.terms: dict[str, list[gtsam.NonlinearFactor]] = {}
        for key, one in self.known.items():
            # Images of a vehicle count by a share, and so does what each is taken to know.
            covariance = one.covariance / shares[key]
            prior = ZeroPrior(key, gtsam.noiseModel.Gaussian.Covariance(covariance))
            self.terms.setdefault(PLACE if isinstance(one, UnsurePlace) else DEPTH, []).append(prior)

    @property
    def priors(self) -> list[gtsam.NonlinearFactor]:
        """What is known of all of them."""
        return [prior for priors in self.terms.values() for prior in priors]

    def insert_missing(self, values: gtsam.Values) -> None:
        """Add those that values have not yet."""
        for key, one in self.known.items():
            if not values.exists(key):
                values.insert(key, np.zeros(len(one.covariance)))

    def key(self, part: ObservationPart, term: PointTerm) -> int | None:
        """Of what an observation's points share with those of others; None where that is no variable."""
        return None if term.shared is None else self._keys.get((part.image, term.shared.key))

    def of(self, part: ObservationPart) -> list[int]:
        """Keys of all that an observation shares with others."""
        keys = (self.key(part, term) for term in part.problem.energy.points)
        return [key for key in keys if key is not None]
