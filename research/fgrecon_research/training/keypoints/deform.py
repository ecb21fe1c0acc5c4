"""Smooth displacement fields that make other shapes of the cars in photographs.

A field (S, S, 2) in pixels says where a deformed image takes its pixels from: pixel p shows what was at p + field(p).
Shapes in the photographs are few, and the car models behind the labels fewer: a network that has seen each part in
many places relative to the others looks for the part, not for where most cars have it.
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Field = NDArray[np.float32]

_PLACES = 4  # a random field is drawn at so many places along each side
_GRID = 24  # and one that moves points is computed at so many
_REACH = 0.16  # standard deviation of the Gaussians that carry points along, as a fraction of the side
_RIDGE = 0.05  # lets points that are close together be moved apart only a little
_STEEPEST = 0.7  # norm of a field's derivative; from 1 on it may fold the image
_STEPS = 12


def random_field(side: int, spread: float, rng: np.random.Generator) -> Field:
    """A smooth random field over side x side pixels, of that standard deviation in pixels at its nodes."""
    coarse = rng.normal(0.0, spread, (_PLACES, _PLACES, 2)).astype(np.float32)
    return np.asarray(cv2.resize(coarse, (side, side), interpolation=cv2.INTER_CUBIC), dtype=np.float32)


def move_points(side: int, points: Array, by: Array) -> Field:
    """The field that moves points (K, 2) by about as many pixels `by` (K, 2), and what is around them along.

    Radial basis functions with a ridge. What would fold the image is moved less, so that points end where
    `deform_points` says, not exactly where they were sent. Points with NaN do not count.
    """
    known = np.isfinite(points).all(axis=1)
    ends = (points + by)[known] / side
    square = ((ends[:, None] - ends[None]) ** 2).sum(axis=-1)
    kernel = np.exp(-square / (2.0 * _REACH**2)) + _RIDGE * np.eye(len(ends))
    weights = np.linalg.solve(kernel, -by[known])
    row, column = (np.mgrid[:_GRID, :_GRID] + 0.5) / _GRID - 0.5 / side
    away = (column[..., None] - ends[:, 0]) ** 2 + (row[..., None] - ends[:, 1]) ** 2
    coarse = np.exp(-away / (2.0 * _REACH**2)) @ weights
    down, right = np.gradient(coarse, side / _GRID, axis=(0, 1))
    slope = float(np.sqrt((down**2 + right**2).sum(axis=-1)).max())
    coarse *= min(1.0, _STEEPEST / max(slope, 1e-9))
    return np.asarray(cv2.resize(coarse.astype(np.float32), (side, side), interpolation=cv2.INTER_CUBIC))


def deform(pixels: NDArray[np.uint8], field: Field) -> NDArray[np.uint8]:
    """The image (S, S) or (S, S, 3) deformed by a field; black where it takes its pixels from outside."""
    row, column = np.mgrid[: len(field), : len(field)].astype(np.float32)
    taken = cv2.remap(
        pixels, column + field[..., 0], row + field[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT
    )
    return np.asarray(taken, dtype=np.uint8)


def deform_points(points: Array, field: Field) -> Array:
    """Where points (K, 2) of an image are in the deformed one; NaN stays NaN."""
    moved = points
    for _ in range(_STEPS):  # p = point - field(p): a contraction, since the field is not steep
        moved = points - sampled(field, np.nan_to_num(moved))
    return moved


def sampled(values: NDArray[Any], places: Array) -> Array:
    """Values (N, ...) of an image (H, W, ...) at places (N, 2) in pixels, bilinear; those of its border beyond it."""
    column, row = np.ascontiguousarray(places.T.astype(np.float32))[:, None]
    found = cv2.remap(
        values.astype(np.float32, copy=False), column, row, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
    )
    return np.asarray(found[0], dtype=np.float64)
