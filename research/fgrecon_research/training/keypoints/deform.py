"""Smooth displacement fields that change the shapes of the cars in photographs.

A field (S, S, 2) in pixels says where a deformed image takes its pixels from: pixel p shows what was at p + field(p).
Shapes in the photographs are few, and the car models behind the labels fewer: a network that has seen each part in
many places relative to the others looks for the part, not for where most cars have it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from fgrecon.core.arrays import Array
from fgrecon.core.category import Category

# A picture of a car with its labels.


Pixels = NDArray[np.uint8]

Partner = NDArray[np.intp]
"""(K,) index of each keypoint's mirror image."""

UNKNOWN_KIND = -1
"""In the place of a kind's number."""

_AS_TALL = 1.15
"""A car whose cabin is raised by more is of no kind that anybody could name."""


@dataclass(frozen=True)
class LabelledView:
    """A photograph of a car with its labels."""

    image: Pixels  # (H, W, 3) RGB
    mask: Pixels  # (H, W) 255 on the car, 0 elsewhere
    keypoints: Array  # (K, 2) pixels; NaN where unknown
    visible: Array  # (K,) probability that each can be seen
    azimuth: float  # direction from the car to the camera, radians; 0 ahead, pi / 2 to its left
    # (4,) box of the car x1, y1, x2, y2 in pixels, where the image shows more than the car; else None
    within: Array | None = None
    kind: int = UNKNOWN_KIND  # number of its kind in `fgrecon.perception.keypoints.layout.KINDS`

    @property
    def box(self) -> Array:
        """(4,) box of the car x1, y1, x2, y2 in pixels."""
        height, width = self.image.shape[:2]
        return np.array([-0.5, -0.5, width - 0.5, height - 0.5]) if self.within is None else self.within

    def mirrored(self, partner: Partner) -> LabelledView:
        """The mirror image, in which left and right of the car have changed places."""
        flipped = self.keypoints[partner] * [-1.0, 1.0] + [self.image.shape[1] - 1.0, 0.0]
        image, mask = (np.ascontiguousarray(a[:, ::-1]) for a in (self.image, self.mask))
        within = self.within
        if within is not None:
            x1, y1, x2, y2 = within
            within = np.array([self.image.shape[1] - 1.0 - x2, y1, self.image.shape[1] - 1.0 - x1, y2])
        return LabelledView(image, mask, flipped, self.visible[partner], -self.azimuth, within, self.kind)


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


# Taller cars out of photographs: everything above the lamps is stretched upwards, as a van stands higher than a car.
#
# Photographs to learn from show hardly any van. A level camera keeps the vertical lines of a car vertical, so that a
# stretch of the image's columns above a line through the lamps is one of the cabin.


_STEEPEST = 0.5  # slope of a belt that is believed: in a picture it is about level


def belt_of(category: Category, shape: Array) -> tuple[int, ...]:
    """Keypoints of the highest face that shares none with the roof: above them is the cabin. Empty where there is none.

    Args:
        shape: (K, 3) mean shape, whose second axis points down.
    """
    faces = [face.keypoints for face in category.faces]
    if not faces:
        return ()
    roof = min(faces, key=lambda face: float(shape[list(face), 1].mean()))
    below = [face for face in faces if not set(face) & set(roof)]
    return tuple(min(below, key=lambda face: float(shape[list(face), 1].mean()))) if below else ()


def raise_cabin(view: LabelledView, belt: tuple[int, ...], factor: float) -> LabelledView:
    """The car with everything above its belt stretched by a factor (from 1), and the image taller accordingly.

    It is returned as it is where the belt is unknown or far from level.
    """
    points = view.keypoints[list(belt)]
    points = points[np.isfinite(points).all(axis=1)]
    known = np.isfinite(view.keypoints).all(axis=1)
    if len(points) < 2 or factor <= 1.0:
        return view
    centre = points.mean(axis=0)
    away = points - centre
    slope = float(away[:, 0] @ away[:, 1]) / max(float(away[:, 0] @ away[:, 0]), 1e-9)
    if abs(slope) > _STEEPEST:
        return view

    def line(column: Array) -> Array:
        return np.asarray(centre[1] + slope * (column - centre[0]))

    moved = view.keypoints.copy()
    above = line(moved[:, 0]) - moved[:, 1]
    moved[:, 1] -= (factor - 1.0) * np.maximum(above, 0.0)
    top = np.flatnonzero(known)[view.keypoints[known, 1].argmin()]
    x1, y1, x2, y2 = view.box
    by = max(int(np.ceil(view.keypoints[top, 1] - moved[top, 1])), 0)  # rows that are new
    height, width = view.image.shape[:2]
    row, column = np.mgrid[-by:height, :width].astype(np.float32)
    at = line(column).astype(np.float32)
    taken = np.where(row < at, at - (at - row) / np.float32(factor), row)
    image = cv2.remap(view.image, column, taken, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    mask = cv2.remap(view.mask, column, taken, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT)
    within = None if view.within is None else np.array([x1, y1, x2, y2 + by])
    return replace(
        view,
        image=np.asarray(image),
        mask=np.asarray(mask),
        keypoints=moved + np.array([0.0, by]),
        within=within,
        kind=view.kind if factor <= _AS_TALL else UNKNOWN_KIND,
    )
