"""Part of the graph about other sensors' evidence of a vehicle in one image: points, its silhouette, its range.

Errors that all points of a sensor share are variables: a depth map's scale, a LiDAR's extrinsics.

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
from factors.placed_points import PlacedPointsFactor
from factors.sensed import SensedFactor
from factors.silhouette import SilhouetteFactor
from factors.surface_points import NOTHING_SHARED, SurfacePointsFactor
from factors.vehicle_range import RangeFactor, RangeRows
from fgrecon.core.evidence import Range
from fgrecon.solve.graph.observation_part import ObservationPart
from fgrecon.solve.proposals.point_term import PointTerm
from fgrecon.solve.proposals.scaled_depth import ScaledDepth
from fgrecon.solve.proposals.search_settings import SETTINGS
from fgrecon.solve.proposals.unsure_place import UnsurePlace

DEPTH, PLACE = "depth_scale", "sensor_place"
"""Energy terms of what is known of scale and shift, and of a sensor's place."""


class SharedErrors:
    """The errors that points of one sensor share.

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


def sensed_of(part: ObservationPart, shared: SharedErrors) -> list[SensedFactor]:
    """What is given beside the keypoints of an observation; nothing where pose and shape are constants."""
    shape, observation = part.vehicle.shape, part.problem.observation
    if not observation.evidence or not (part.pose_key is not None or shape.coefficients_key is not None):
        return []
    none = gtsam.Values()
    pose = part.kernel.pose(none) if part.pose_key is None else part.pose_key
    coefficients = shape.coefficients(none) if shape.coefficients_key is None else shape.coefficients_key
    off, model = part.problem.options.disabled_terms, part.problem.model
    found: list[SensedFactor] = []
    for points in part.problem.energy.points:
        key = shared.key(part, points)
        if isinstance(points.shared, UnsurePlace) and key is not None:
            found.append(PlacedPointsFactor(points.rows, pose, coefficients, key, part.share, points.name))
        else:
            by = NOTHING_SHARED if key is None else key
            found.append(SurfacePointsFactor(points.rows, pose, coefficients, by, part.share, points.name))
    if RangeFactor.name not in off:
        size = model.dimension_mean, model.dimension_basis
        for one in observation.evidence:
            if isinstance(one, Range):
                rows = RangeRows(one.metres, one.sigma, one.origin, *size, to_centre=one.to_centre)
                found.append(RangeFactor(rows, pose, coefficients))
    if part.focal_key is None:
        masks = part.problem.energy.masks
        found += [SilhouetteFactor(one.rows, pose, coefficients, part.share) for one in masks]
    return found


def common_factor(sensed: SensedFactor) -> float:
    """By how much less it says of covariances, since its errors are alike in neighbouring places."""
    if isinstance(sensed, SurfacePointsFactor):
        return SETTINGS.points.common_factor
    return SETTINGS.masks.common_factor if isinstance(sensed, SilhouetteFactor) else 1.0
