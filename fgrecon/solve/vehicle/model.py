"""A shape prior prepared for solving: conditioned on a size, with visibility table and the points its box encloses."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np

from factors.box import OUTWARD, soft_extents
from fgrecon.core.arrays import Array
from fgrecon.core.box3d import box_corners
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.geometry import yaw_rotation
from fgrecon.core.options import BoxModel
from fgrecon.core.shape_prior import ShapePrior
from fgrecon.core.size_prior import SizePrior, other_fleets
from fgrecon.solve.vehicle.conditioning import given_size, is_one_vehicle, of_fleet
from fgrecon.solve.vehicle.visibility import VisibilityTable

_ALL_ROUND, _LEVEL, _UPWARDS = 60, 30, 60
"""Directions of one half of a vehicle in which its outline is looked for: all round, level, nearly upright ones."""

_UPWARDS_RADIANS = float(np.deg2rad(20.0))
"""How far from the vertical upright ones are."""

_VIEWS, _HEIGHT, _DISTANCE, _SOFTNESS = 24, 0.4, 5.0, 0.015
"""Views in which soft extents are compared: how many, the camera's height and distance in lengths of the vehicle, and
the softness as a share of the longer side."""


@dataclass(frozen=True)
class LinearPoints:
    """P points that move linearly with lambda: mean (P, 3) and basis (N, P, 3), object frame, metres."""

    mean: Array
    basis: Array

    def at(self, coefficients: Array) -> Array:
        """(P, 3) points at the coefficients (N,)."""
        return self.mean + np.tensordot(coefficients, self.basis, axes=1)

    @cached_property
    def inside(self) -> Array:
        """(4,) softnesses by which soft extents of these points lie inside the hard ones, left, up, right, down.

        The mean over views all round of the mean shape, as a car's camera has them.
        """
        angles = 2.0 * np.pi * np.arange(_VIEWS) / _VIEWS
        turned = self.mean @ np.stack([yaw_rotation(angle).T for angle in angles])
        points = turned + np.ptp(self.mean, axis=0).max() * np.array([0.0, _HEIGHT, _DISTANCE])
        pixels = points[..., :2] / points[..., 2:]
        hard = np.concatenate([pixels.min(axis=1), pixels.max(axis=1)], axis=1)
        softness = _SOFTNESS * (hard[:, 2:] - hard[:, :2]).max(axis=1)
        soft, _ = soft_extents(pixels, softness[:, None, None])
        left, up, right, down = np.mean(OUTWARD * (hard - soft) / softness[:, None], axis=0)
        sides = 0.5 * (left + right)
        return np.array([sides, up, sides, down])


@dataclass(frozen=True, eq=False)
class VehicleModel:
    """What solving needs of a category and its prior, computed once."""

    # the prior; where a size was given that of the fleet, or conditioned on the size of the one vehicle
    # (`fgrecon.solve.vehicle.conditioning.is_one_vehicle` decides)
    prior: ShapePrior
    size: SizePrior | None  # the fleet's size prior; None where none was given, and where the prior holds it already
    fleet_given: bool  # whether one was given
    visibility: VisibilityTable  # how visible each keypoint of the mean shape is from everywhere
    # surface points that can lie on the outline, for tight 2D boxes; the box's corners without a surface
    outline: LinearPoints
    corners: LinearPoints  # the eight corners of the vehicle's 3D box
    dimension_mean: Array  # (3,) length, width and height of the mean shape's box
    dimension_basis: Array  # (3, N) their change per unit of each coefficient

    def box_points(self, box_model: BoxModel) -> LinearPoints:
        """The points that a 2D box encloses."""
        return self.corners if box_model is BoxModel.CUBOID else self.outline

    @cached_property
    def size_errors(self) -> tuple[Array, Array] | None:
        """(N, N) how much more lambda pulls at a solve than it assumes: with the sizes of the traffic, or of one class.

        A prior with the information Q pulls lambda to zero by Q lambda. Where lambda has the covariance S that is noise
        of Q S Q, for which the solve takes Q: this is the difference. None where no size was given.
        """
        if self.size is None:
            return None
        by_size = self.dimension_basis / self.size.assumed_sigma[:, None]
        assumed = np.eye(self.prior.dimension) + by_size.T @ by_size
        spreads = [self.spread_of(sizes) for sizes in (self.size.spread, self.size.own_spread)]
        traffic, own = (assumed @ spread @ assumed - assumed for spread in spreads)
        return traffic, own

    @cached_property
    def by_size(self) -> Array:
        """(N, 3) smallest change of lambda for a change of length, width and height."""
        return np.linalg.pinv(self.dimension_basis).astype(np.float64)

    @cached_property
    def by_keypoints(self) -> Array:
        """(N, 3K) least-squares change of lambda for a change of the keypoints."""
        return np.linalg.pinv(self.prior.basis.reshape(self.prior.dimension, self.prior.mean.size).T).astype(np.float64)

    @property
    def fleet_spread(self) -> Array:
        """(3, 3) covariance of the mean size of the vehicles' fleet, where none is given."""
        return other_fleets(self.dimension_mean)

    @property
    def any_fleet_spread(self) -> Array:
        """(N, N) covariance of lambda where no fleet is given: the prior's within one, and how far fleets differ."""
        by_size = self.by_size
        fleets: Array = by_size @ self.fleet_spread @ by_size.T
        return np.eye(len(fleets)) + fleets

    def spread_of(self, sizes: Array) -> Array:
        """(N, N) covariance of lambda that gives sizes the covariance (3, 3), and else is that of the prior, I."""
        basis, by_size = self.dimension_basis, self.by_size
        change: Array = by_size @ (sizes - basis @ basis.T) @ by_size.T
        return np.eye(len(by_size)) + change


@lru_cache(maxsize=16)
def prepare(prior: ShapePrior, size: SizePrior | None = None, basis_vectors: int | None = None) -> VehicleModel:
    """The model of a prior and a size; remembered, since the visibility table takes a moment.

    Raises:
        InvalidInputError: The prior has fewer basis vectors than asked for.
    """
    if basis_vectors is not None:
        if basis_vectors > prior.dimension:
            fix = f"Prior {prior.name} has {prior.dimension} basis vectors: give at most so many."
            raise InvalidInputError("options.shape.basis_vectors", basis_vectors, fix)
        prior = prior.truncated(basis_vectors)
    prior, left = _brought_to(prior, size)
    return _model(prior, left, VisibilityTable.build(prior), fleet_given=size is not None)


def sized(model: VehicleModel, size: SizePrior) -> VehicleModel:
    """The model of a vehicle of another size: as `prepare` makes it, but for the visibility, which is the model's own.

    What hides what is nearly the same in cars of all sizes, and the table is what takes long.

    Args:
        model: Prepared without a size.
        size: The vehicle's.
    """
    prior, left = _brought_to(model.prior, size)
    return _model(prior, left, model.visibility, fleet_given=True)


@lru_cache(maxsize=64)
def in_traffic(model: VehicleModel) -> VehicleModel:
    """The model of a vehicle whose size a solve allows all that the traffic's is; remembered.

    Less is best where one image measures size and distance, and a van is a car that is nearer. Where its distance is
    measured it is not, and what is as high as a van may be one.
    """
    if model.size is None:
        return model
    free = model.size.as_in_traffic
    return model if np.array_equal(free.assumed_sigma, model.size.assumed_sigma) else replace(model, size=free)


def _brought_to(prior: ShapePrior, size: SizePrior | None) -> tuple[ShapePrior, SizePrior | None]:
    """The prior of vehicles of a size, and what of the size it does not hold."""
    if size is None:
        return prior, None
    if is_one_vehicle(prior, size):
        return given_size(prior, size), None
    return of_fleet(prior, size), size


def _model(
    prior: ShapePrior, size: SizePrior | None, visibility: VisibilityTable, *, fleet_given: bool
) -> VehicleModel:
    operator = prior.category.dimension_operator
    mean = np.tensordot(operator, prior.mean, axes=2)
    basis = np.tensordot(operator, prior.basis, axes=((1, 2), (1, 2)))
    corners = LinearPoints(box_corners(mean), np.array([box_corners(column) for column in basis.T]).reshape(-1, 8, 3))
    outline = corners if prior.surface is None else _outline(prior)
    return VehicleModel(prior, size, fleet_given, visibility, outline, corners, mean, basis)


def _outline(prior: ShapePrior) -> LinearPoints:
    """The surface vertices that are farthest in some direction: those that a tight box can touch.

    The edges of a level camera's image look in level and in nearly upright directions. Of these there are more: a roof
    is flat, and each of its highest points that is left out makes it lower. Each direction is there with its mirror
    image, so that the mirrored image of a vehicle has its mirrored pose.
    """
    assert prior.surface is not None
    angle = np.pi * (np.arange(_LEVEL) + 0.5) / _LEVEL
    level = np.stack([np.cos(angle), np.zeros(_LEVEL), np.sin(angle)])
    x, z, up = _directions(_UPWARDS, _UPWARDS_RADIANS)
    half = np.hstack([_directions(_ALL_ROUND, np.pi / 2), level, np.stack([x, -up, z])])
    directions = np.hstack([half, half * [[1.0], [1.0], [-1.0]]])
    chosen = np.unique((prior.surface.mean @ directions).argmax(axis=0))
    return LinearPoints(prior.surface.mean[chosen], prior.surface.basis[:, chosen])


def _directions(count: int, widest: float) -> Array:
    """Unit vectors (3, count) up to an angle in radians from the z axis: part of a Fibonacci sphere, which is even."""
    index = np.arange(count) + 0.5
    cosine, angle = 1.0 - (1.0 - np.cos(widest)) * index / count, np.pi * (1.0 + 5.0**0.5) * index
    return np.vstack([np.sqrt(1.0 - cosine**2) * np.stack([np.cos(angle), np.sin(angle)]), cosine])
