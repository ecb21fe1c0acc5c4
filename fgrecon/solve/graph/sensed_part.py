"""Part of the graph about other sensors' evidence of a vehicle in one image: points, its silhouette, its range."""

from __future__ import annotations

import gtsam

from factors.placed_points import PlacedPointsFactor
from factors.sensed import SensedFactor
from factors.silhouette import SilhouetteFactor
from factors.surface_points import NOTHING_SHARED, SurfacePointsFactor
from factors.vehicle_range import RangeFactor, RangeRows
from fgrecon.core.evidence import Range
from fgrecon.solve.graph.observation_part import ObservationPart
from fgrecon.solve.graph.shared_errors import SharedErrors
from fgrecon.solve.proposals.search_settings import SETTINGS
from fgrecon.solve.proposals.unsure_place import UnsurePlace


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
    if not part.has_free_focal:
        masks = part.problem.energy.masks
        found += [SilhouetteFactor(one.rows, pose, coefficients, part.share) for one in masks]
    return found


def common_factor(sensed: SensedFactor) -> float:
    """By how much less it says of covariances, since its errors are alike in neighbouring places."""
    if isinstance(sensed, SurfacePointsFactor):
        return SETTINGS.points.common_factor
    return SETTINGS.masks.common_factor if isinstance(sensed, SilhouetteFactor) else 1.0
