"""How far priors are from real shapes that they were not learnt from."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from fgrecon.core.arrays import Array
from fgrecon.core.checks import as_finite
from fgrecon.core.shape_prior import ShapePrior
from fgrecon_research.training.priors.compare import align, motions

_ITERATIONS = 10


def mean_error(prior: ShapePrior, shapes: ArrayLike) -> tuple[float, float, Array]:
    """Error of a prior's mean against the mean of real shapes, after a similarity alignment.

    Args:
        prior: The prior.
        shapes: (M, K, 3) real shapes in the object frame and the prior's keypoint order, metres.

    Returns:
        The RMS over keypoints in metres, the same in percent of the length of the real mean's box, and the difference
        prior minus real (K, 3), metres.

    Raises:
        InvalidInputError: Wrong shapes or values.
    """
    real = as_finite("shapes", shapes, (None, prior.category.size, 3)).mean(axis=0)
    difference = align(prior.mean, real)[0] - real
    rms = float(np.sqrt(np.square(difference).sum(axis=1).mean()))
    length = float(np.tensordot(prior.category.dimension_operator[0], real, axes=2))
    return rms, 100.0 * rms / length, difference


def expression_error(prior: ShapePrior, shapes: ArrayLike, *, similarity: bool = True) -> Array:
    """How well a prior's vectors express shapes that it was not learnt from: least squares over the coefficients.

    Args:
        prior: The prior.
        shapes: (M, K, 3) shapes in the object frame, metres.
        similarity: Whether rotation, translation and scale are free too, as they are for a prior learnt from images
            of unknown scale.

    Returns:
        (M,) RMS over the keypoints, in the shapes' metres.

    Raises:
        InvalidInputError: Wrong shapes or values.
    """
    points = as_finite("shapes", shapes, (None, prior.category.size, 3))
    return np.array([_expression_error(prior, shape, similarity=similarity) for shape in points])


def _expression_error(prior: ShapePrior, shape: Array, *, similarity: bool) -> float:
    """Gauss-Newton over coefficients and similarity together, the similarity made exact after each step."""
    coefficients = np.zeros(prior.dimension)
    moved, scale, rotation = prior.mean, 1.0, np.eye(3)
    for _ in range(_ITERATIONS if similarity else 1):
        if similarity:
            moved, scale, rotation = align(prior.keypoints(coefficients), shape)
        columns = (scale * prior.basis @ rotation.T).reshape(prior.dimension, shape.size)
        if similarity:
            columns = np.concatenate([columns, motions(moved)])
        step = np.linalg.lstsq(columns.T, (shape - moved).ravel(), rcond=1e-9)[0]
        coefficients += step[: prior.dimension]
        moved = prior.keypoints(coefficients)
    if similarity:
        moved = align(moved, shape)[0]
    return float(np.sqrt(np.square(moved - shape).sum(axis=1).mean()))
