"""What a graph holds of what other sensors say of a vehicle in one image: points, its silhouette, its range."""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache

import gtsam
import numpy as np

from factors.distance_field import DistanceField
from factors.placed_points import PlacedPointsFactor
from factors.sensed import SensedFactor
from factors.silhouette import SilhouetteFactor, SilhouetteOdds, SilhouetteRows
from factors.surface_points import NOTHING_SHARED, SurfacePointsFactor
from factors.vehicle_range import RangeFactor, RangeRows
from fgrecon.core.arrays import Array
from fgrecon.core.evidence import Range
from fgrecon.core.mask import Mask, joined
from fgrecon.solve.graph.graph_settings import SETTINGS
from fgrecon.solve.graph.observation_part import ObservationPart
from fgrecon.solve.graph.shared_errors import SharedErrors
from fgrecon.solve.proposals.search_settings import SETTINGS as SEARCH
from fgrecon.solve.proposals.unsure_place import UnsurePlace

MASKS = SETTINGS.masks


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
    if SilhouetteFactor.name not in off and not part.has_free_focal:
        found += [SilhouetteFactor(rows, pose, coefficients, part.share) for rows in _silhouettes(part)]
    return found


def common_factor(sensed: SensedFactor) -> float:
    """By how much less it says of covariances, since its errors are alike in neighbouring places."""
    if isinstance(sensed, SurfacePointsFactor):
        return SEARCH.points.common_factor
    return MASKS.common_factor if isinstance(sensed, SilhouetteFactor) else 1.0


def _silhouettes(part: ObservationPart) -> Iterator[SilhouetteRows]:
    """The silhouette of an observation, if it has one; the other masks hide the vehicle."""
    problem = part.problem
    masks = [one for one in problem.observation.evidence if isinstance(one, Mask)]
    own, hiding = [one for one in masks if not one.hides], [one for one in masks if one.hides]
    outline, camera = problem.model.outline, problem.camera
    for mask in own[:1]:
        sigma = mask.outline_sigma
        span = MASKS.span_share * float((mask.box[2:] - mask.box[:2]).max())
        odds = SilhouetteOdds(
            MASKS.right, span, MASKS.hidden_sigmas * sigma, SEARCH.border_pixels, MASKS.independent_rows
        )
        hides = _hidden(tuple(hiding)) if hiding else None
        size = camera.image_size or mask.image_size
        directions = _directions(MASKS.directions)
        farthest = _farthest(mask, MASKS.directions)
        surface = outline.mean, outline.basis
        yield SilhouetteRows(mask.field, hides, camera.matrix, size, *surface, directions, farthest, sigma, odds)


@lru_cache(maxsize=4)
def _directions(count: int) -> Array:
    """(2, count) unit vectors all around."""
    angles = 2.0 * np.pi * np.arange(count) / count
    return np.stack([np.cos(angles), np.sin(angles)])


@lru_cache(maxsize=64)  # several graphs are made of a vehicle
def _farthest(mask: Mask, count: int) -> Array:
    return mask.farthest(_directions(count))


@lru_cache(maxsize=64)
def _hidden(hiding: tuple[Mask, ...]) -> DistanceField:
    return joined(hiding).field
