"""Conditioning of a shape prior on a size: of one vehicle whose size is known, or of a fleet.

Scaling a prior to a size (`ShapePrior.for_fleet`) stretches every part of the mean car alike. The size tells more:
long, tall cars are vans and SUVs, whose parts lie elsewhere than those of a stretched saloon, and small cars have short
overhangs. With each of the 79 car models left out of the shipped kind of prior in turn, the mean keypoint distance of
the mean shape, about its centroid, is 13.4 cm as it is, 10.4 cm scaled to the true size, and 7.6 cm conditioned on it
(medians). So the mean shape of a fleet is the one that its sizes make probable.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from fgrecon.core.arrays import Array
from fgrecon.core.checks import as_finite, as_shape
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.shape_prior import ShapePrior, Surface
from fgrecon.core.size_prior import SizePrior


@dataclass(frozen=True)
class ConditioningSettings:
    """When a prior takes a given size. Not tuned."""

    tight_share: float = 0.5  # of the prior's own spread: from there on a size tells one vehicle from another
    plausible_sigmas: float = 4.0  # from the prior's sizes up to which it knows such a vehicle


SETTINGS = ConditioningSettings()
"""What is used."""


@dataclass(frozen=True)
class SizeRelation:
    """Length, width and height of vehicles as a linear function of a prior's coefficients."""

    mean: Array  # (3,) size at the mean shape, metres
    jacobian: Array  # (3, N) its change per unit of each coefficient
    covariance: Array  # (3, 3) of what the coefficients leave open: bumpers and roof rails are not keypoints

    @classmethod
    def by_ratios(cls, prior: ShapePrior) -> SizeRelation:
        """The category's fixed ratios between keypoints and box, taken as exact."""
        jacobian = np.einsum("dki,nki->dn", prior.category.dimension_operator, prior.basis)
        return cls(prior.box_size(np.zeros(prior.dimension)), jacobian, np.zeros((3, 3)))


def learn_size_relation(prior: ShapePrior, shapes: ArrayLike, sizes: ArrayLike) -> SizeRelation:
    """The relation between a prior's coefficients and the box, by least squares over shapes of measured size.

    Args:
        prior: Shape prior, with N basis vectors.
        shapes: (M, K, 3) keypoints of M > N + 1 shapes, object frame, metres.
        sizes: (M, 3) length, width and height of each, metres.

    Raises:
        InvalidInputError: Wrong shapes or values, or too few of them.
    """
    coefficients, _ = express(prior, shapes)
    measured = as_finite("sizes", sizes, (len(coefficients), 3))
    spare = len(coefficients) - prior.dimension - 1
    if spare < 1:
        fix = f"Give more than {prior.dimension + 1}, or a prior with fewer vectors."
        raise InvalidInputError("shapes", len(coefficients), fix)
    design = np.column_stack([np.ones(len(coefficients)), coefficients])
    solution = np.linalg.lstsq(design, measured, rcond=None)[0]
    left = measured - design @ solution
    jacobian: Array = np.ascontiguousarray(solution[1:].T, dtype=np.float64)
    return SizeRelation(solution[0], jacobian, left.T @ left / spare)


def is_one_vehicle(prior: ShapePrior, size: SizePrior) -> bool:
    """Whether a size is that of one vehicle of the prior's kind: known better than the prior's own, and among them.

    Otherwise it is a fleet's, or that of a vehicle that the prior knows nothing of.
    """
    relation = SizeRelation.by_ratios(prior)
    spread = relation.jacobian @ relation.jacobian.T
    if (size.sigma >= SETTINGS.tight_share * np.sqrt(np.diag(spread))).any():
        return False
    away = size.mean - relation.mean
    return bool(away @ np.linalg.solve(spread + np.diag(size.sigma**2), away) <= SETTINGS.plausible_sigmas**2)


def given_size(prior: ShapePrior, size: SizePrior, relation: SizeRelation | None = None) -> ShapePrior:
    """The prior's distribution given a measured size: Gaussian conditioning, in the same subspace.

    The result is a prior as any other: its coefficients are unit-variance and unrelated to those of `prior`.

    Args:
        prior: Shape prior, with N basis vectors.
        size: Length, width and height with the standard deviations of their measurement, metres.
        relation: How sizes go with coefficients; None takes the category's ratios.
    """
    known = SizeRelation.by_ratios(prior) if relation is None else relation
    whitener = np.linalg.inv(np.linalg.cholesky(known.covariance + np.diag(size.sigma**2)))
    scaled = whitener @ known.jacobian
    precision = np.eye(prior.dimension) + scaled.T @ scaled
    coefficients = np.linalg.solve(precision, scaled.T @ whitener @ (size.mean - known.mean))
    values, vectors = np.linalg.eigh(np.linalg.inv(precision))
    order = np.argsort(-values)
    spread = (vectors * np.sqrt(values))[:, order]  # columns: directions of lambda, the least determined first
    basis = np.tensordot(spread.T, prior.basis, axes=1)
    surface = prior.surface
    if surface is not None:
        moved = np.tensordot(spread.T, surface.basis, axes=1)
        surface = Surface(surface.vertices(coefficients), moved, surface.faces)
    variance = np.square(basis).sum(axis=(1, 2))
    return replace(
        prior,
        mean=prior.keypoints(coefficients),
        basis=basis,
        explained=variance / max(float(variance.sum()), 1e-12) * float(prior.explained.sum()),
        surface=surface,
        name=f"{prior.name} given {size.name}",
    )


def of_fleet(prior: ShapePrior, size: SizePrior) -> ShapePrior:
    """The prior of a fleet: its mean is the shape that the fleet's size makes probable, its spread as it was.

    What then is left of the fleet's mean size is scaled per axis, as `ShapePrior.for_fleet` does.
    """
    relation = SizeRelation.by_ratios(prior)
    by_size = relation.jacobian
    away = size.mean - relation.mean
    coefficients = by_size.T @ np.linalg.solve(by_size @ by_size.T + np.diag(size.sigma**2), away)
    coefficients *= min(1.0, SETTINGS.plausible_sigmas / max(float(np.linalg.norm(coefficients)), 1e-12))
    surface = prior.surface
    if surface is not None:
        surface = Surface(surface.vertices(coefficients), surface.basis, surface.faces)
    moved = replace(prior, mean=prior.keypoints(coefficients), surface=surface)
    return replace(moved.for_fleet(size), name=f"{prior.name} of {size.name}")


def express(prior: ShapePrior, shapes: ArrayLike) -> tuple[Array, Array]:
    """Least-squares coefficients of shapes in a prior's subspace, and what is left over.

    Args:
        prior: The prior, with N basis vectors.
        shapes: (M, K, 3) keypoints in the object frame, metres; NaN where a keypoint is missing.

    Returns:
        (M, N) coefficients and (M, K, 3) residuals in metres, NaN where a keypoint is missing.

    Raises:
        InvalidInputError: Wrong shapes.
    """
    points = as_shape("shapes", shapes, (None, prior.category.size, 3))
    difference = (points - prior.mean).reshape(len(points), -1)
    observed = np.isfinite(difference)
    columns = prior.basis.reshape(prior.dimension, prior.mean.size).T
    coefficients = np.zeros((len(points), prior.dimension))
    if observed.all():
        coefficients[:] = np.linalg.lstsq(columns, difference.T, rcond=None)[0].T
    else:
        for row, present, values in zip(coefficients, observed, difference, strict=True):
            row[:] = np.linalg.lstsq(columns[present], values[present], rcond=None)[0]
    residual: Array = difference - coefficients @ columns.T
    return coefficients, residual.reshape(points.shape)
