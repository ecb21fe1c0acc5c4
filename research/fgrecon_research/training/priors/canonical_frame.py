"""Canonical object frame of a factorisation, by the category's semantics alone."""

from __future__ import annotations

import numpy as np

from fgrecon.core.arrays import Array
from fgrecon.core.category import Category
from fgrecon.core.errors import DegenerateProblemError
from fgrecon.core.size_prior import SizePrior

_SEPARATION = 0.05


def object_axes(category: Category, mean: Array) -> Array:
    """Axes of the object frame (x forward, y down, z left) seen from the frame of a mean shape.

    z runs from the right to the left keypoints of the symmetric pairs (without pairs, along the width). The ground
    keypoints, which have one height by definition, give the horizontal across z; where they do not span one, the
    length does. Forward and down follow from the keypoint groups of length and height. Scaled orthography cannot tell
    a shape from its depth reversal; this can, since the axes must come out right-handed for the shape to be the real
    one: where they do not, the matrix has determinant -1 and mapping by it undoes the reversal.

    Args:
        mean: (K, 3) mean shape in any frame, possibly reversed.

    Returns:
        (3, 3) columns x, y, z, orthonormal: `shape @ axes` is in the object frame.

    Raises:
        DegenerateProblemError: The groups of a dimension lie in one place, so that a direction has no sign.
    """
    extent = float(np.sqrt(np.square(mean - mean.mean(axis=0)).sum(axis=1).mean()))
    length, width, height = (
        mean[list(d.plus)].mean(axis=0) - mean[list(d.minus)].mean(axis=0) for d in category.dimensions
    )
    if category.symmetric_pairs:
        left, right = (list(side) for side in zip(*category.symmetric_pairs, strict=True))
        width = (mean[left] - mean[right]).mean(axis=0)
    z = width / _norm("width", width, extent)
    across = np.eye(3) - np.outer(z, z)
    ground = mean[list(category.ground_keypoints)] @ across
    _, spread, directions = np.linalg.svd(ground - ground.mean(axis=0))
    horizontal = directions[0] if spread[0] > _SEPARATION * extent * np.sqrt(len(ground)) else across @ length
    x = horizontal / _norm("length", horizontal, extent)
    forward = float(length @ x)
    if abs(forward) < _SEPARATION * extent:
        _norm("length", np.zeros(3), extent)
    x *= np.sign(forward)
    y = np.cross(z, x)
    down = -float(height @ y)
    if abs(down) < _SEPARATION * extent:
        _norm("height", np.zeros(3), extent)
    return np.stack([x, y * np.sign(down), z], axis=1)


def _norm(name: str, vector: Array, extent: float) -> float:
    norm = float(np.linalg.norm(vector))
    if norm < _SEPARATION * extent:
        fix = (
            f"Let the category's dimensions.{name} name keypoints at both ends of it, "
            "and check that the annotations follow the category's keypoint order."
        )
        raise DegenerateProblemError(f"dimensions.{name}", "both groups of keypoints in one place", fix)
    return norm


def metric_scale(category: Category, mean: Array, size: SizePrior) -> float:
    """Metres per unit of a shape in the object frame: its box (by the category's ratios) against a fleet's.

    The three dimensions rarely agree, since their ratios are those of another fleet; each counts by its spread.

    Raises:
        DegenerateProblemError: A dimension of the shape is not positive.
    """
    box = np.tensordot(category.dimension_operator, mean, axes=2)
    if (box <= 0).any():
        fix = "Check the category's dimensions: plus is the front, left or top end."
        raise DegenerateProblemError("category.dimensions", box.round(3).tolist(), fix)
    weight = 1.0 / np.square(size.sigma)
    return float((weight * box) @ size.mean / ((weight * box) @ box))


def metric_stretch(category: Category, mean: Array, size: SizePrior, proportions: float) -> Array:
    """(3,) factors along x, y and z that bring a mean shape (K, 3) to metres.

    Args:
        proportions: Share of the way from one common factor (0) to those that give the mean the fleet's length, width
            and height (1). Images tell proportions worst of all: those of one trade against the view.

    Raises:
        DegenerateProblemError: A dimension of the shape is not positive.
    """
    scale = metric_scale(category, mean, size)
    box = scale * np.tensordot(category.dimension_operator, mean, axes=2)
    length, width, height = (size.mean / box) ** proportions
    return np.asarray(scale * np.array([length, height, width]))


def at_ground_level(category: Category, shapes: Array) -> Array:
    """Shapes (..., K, 3) moved so that the origin is at ground level below the centre of the box.

    Linear in the shape: applied to the mean and to each basis vector it holds for every coefficient. The centre is
    half way between the two groups of the length, and of the width; the ground lies below the ground keypoints by
    `ground_ratio` of the box's height.
    """
    length, width, _ = category.dimensions
    height = np.einsum("kc,...kc->...", category.dimension_operator[2], shapes)
    moved = np.array(shapes)

    def middle(plus: tuple[int, ...], minus: tuple[int, ...], axis: int) -> Array:
        part = shapes[..., axis]
        return np.asarray(0.5 * (part[..., list(plus)].mean(axis=-1) + part[..., list(minus)].mean(axis=-1)))

    moved[..., 0] -= middle(length.plus, length.minus, 0)[..., None]
    wheels = shapes[..., list(category.ground_keypoints), 1].mean(axis=-1)
    moved[..., 1] -= (wheels + category.ground_ratio * height)[..., None]
    if category.symmetric_pairs:
        left, right = (tuple(side) for side in zip(*category.symmetric_pairs, strict=True))
        moved[..., 2] -= middle(left, right, 2)[..., None]
    else:
        moved[..., 2] -= middle(width.plus, width.minus, 2)[..., None]
    return moved


def levelled(category: Category, mean: Array, basis: Array) -> Array:
    """Basis vectors (N, K, 3) without the turn about z that would tilt the ground keypoints of the mean.

    Images leave the turn of a vector free (the camera turns with it); the object frame does not, to first order.
    """
    ground = list(category.ground_keypoints)
    x = mean[ground, 0] - mean[ground, 0].mean()
    if np.sqrt(np.square(x).mean()) < _SEPARATION * np.abs(mean).max():
        return basis
    slope = basis[:, ground, 1] @ x / np.square(x).sum()
    turn = np.stack([-mean[:, 1], mean[:, 0], np.zeros(len(mean))], axis=1)
    return np.asarray(basis - slope[:, None, None] * turn)
