"""Distance between two shapes, or between a prior and real shapes, up to similarity."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from fgrecon.core.arrays import Array
from fgrecon.core.checks import as_finite
from fgrecon.core.errors import DegenerateProblemError, InvalidInputError
from fgrecon.core.shape_prior import ShapePrior


@dataclass(frozen=True)
class PriorComparison:
    """Two priors side by side, after the similarity that brings the first's mean onto the second's."""

    keypoints: tuple[str, ...]  # Names of the keypoints that both have; the arrays below are over these
    rms: float  # Root mean square distance of the means over the keypoints, metres (of the second)
    percent: float  # The same in percent of the second's length
    distances: Array  # (K',) distance of each keypoint, metres
    differences: Array  # (K', 3) first minus second: forward, down, left, metres
    scale: float  # Factor that the first was scaled by
    # Principal angles between the two subspaces, degrees, smallest first; similarity motions of the mean, which no
    # image of unknown scale can tell from a camera, are taken out of both
    angles: Array
    # Share of the first's variance (its vectors) that lies in the second's subspace, and the reverse
    shared_variance: tuple[float, float]


def align(source: ArrayLike, target: ArrayLike) -> tuple[Array, float, Array]:
    """The similarity that brings one shape nearest to another (Umeyama 1991), without reflection.

    Args:
        source: (K, 3) shape to move.
        target: (K, 3) shape to meet.

    Returns:
        The moved shape (K, 3), the scale, and the rotation R (3, 3): moved = scale * source @ R.T + translation.

    Raises:
        InvalidInputError: Wrong shapes or values.
        DegenerateProblemError: All points of `source` are in one place.
    """
    a = as_finite("source", source, (None, 3))
    b = as_finite("target", target, (len(a), 3))
    centred, centred_b = a - a.mean(axis=0), b - b.mean(axis=0)
    power = float(np.square(centred).sum())
    if power <= 0:
        raise DegenerateProblemError("source", "all points in one place", "Give a shape with an extent.")
    u, strength, vt = np.linalg.svd(centred_b.T @ centred)
    signs = np.array([1.0, 1.0, np.sign(np.linalg.det(u @ vt))])
    rotation = (u * signs) @ vt
    scale = float((strength * signs).sum()) / power
    return scale * centred @ rotation.T + b.mean(axis=0), scale, rotation


def compare_priors(first: ShapePrior, second: ShapePrior) -> PriorComparison:
    """Compare means and subspaces over the keypoints that both priors name.

    Raises:
        InvalidInputError: They have fewer than four keypoints in common.
    """
    names = tuple(name for name in first.category.keypoints if name in second.category.keypoints)
    if len(names) < 4:
        fix = "Compare priors whose categories share at least four keypoint names."
        raise InvalidInputError("priors", f"{len(names)} keypoints in common", fix)
    a, b = (prior.mean[[prior.category.index(name) for name in names]] for prior in (first, second))
    moved, scale, rotation = align(a, b)
    differences = moved - b
    distances = np.linalg.norm(differences, axis=1)
    rms = float(np.sqrt(np.square(distances).mean()))
    rows = [
        _without_similarities(prior.basis[:, [prior.category.index(name) for name in names]] @ turn, b)
        for prior, turn in ((first, scale * rotation.T), (second, np.eye(3)))
    ]
    spaces = [_span(part) for part in rows]
    cosines = np.linalg.svd(spaces[0].T @ spaces[1], compute_uv=False)
    length = float(second.box_size(np.zeros(second.dimension))[0])
    return PriorComparison(
        names,
        rms,
        100.0 * rms / length,
        distances,
        differences,
        scale,
        np.degrees(np.arccos(np.clip(cosines, 0.0, 1.0))),
        (_share(rows[0], spaces[1]), _share(rows[1], spaces[0])),
    )


def _without_similarities(basis: Array, mean: Array) -> Array:
    """(N, 3K) vectors without the parts that move, turn or scale the mean as a whole."""
    frame = np.linalg.qr(motions(mean).T)[0]
    flat = basis.reshape(len(basis), mean.size)
    return np.asarray(flat - flat @ frame @ frame.T)


def motions(shape: Array) -> Array:
    """(7, 3K) changes of a shape (K, 3) by translation, rotation and scale."""
    centred = shape - shape.mean(axis=0)
    motions = [np.tile(axis, (len(shape), 1)) for axis in np.eye(3)]
    motions += [np.cross(axis, centred) for axis in np.eye(3)] + [centred]
    return np.array(motions).reshape(7, -1)


def _span(rows: Array) -> Array:
    """(3K, N') orthonormal columns that span the rows."""
    _, strength, vectors = np.linalg.svd(rows, full_matrices=False)
    kept = strength > 1e-9 * strength.max(initial=1e-300)
    return np.asarray(vectors[kept].T)


def _share(rows: Array, space: Array) -> float:
    total = float(np.square(rows).sum())
    return float(np.square(rows @ space).sum()) / total if total > 0 else 0.0
