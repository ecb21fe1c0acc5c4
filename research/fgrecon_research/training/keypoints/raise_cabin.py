"""Taller cars out of photographs: everything above the lamps is stretched upwards, as a van stands higher than a car.

Photographs to learn from show hardly any van. A level camera keeps the vertical lines of a car vertical, so that a
stretch of the image's columns above a line through the lamps is one of the cabin.
"""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from fgrecon.core.category import Category
from fgrecon_research.training.keypoints.labelled_view import LabelledView

Array = NDArray[np.float64]

_STEEPEST = 0.5  # slope of a belt that is believed: in a picture it is about level


def belt_of(category: Category, shape: Array) -> tuple[int, ...]:
    """Keypoints of the highest face that shares none with the roof: above them is the cabin. Empty where there is none.

    Args:
        category: With faces.
        shape: (K, 3) mean shape, whose second axis points down.
    """
    faces = [face.keypoints for face in category.faces]
    if not faces:
        return ()
    roof = min(faces, key=lambda face: float(shape[list(face), 1].mean()))
    below = [face for face in faces if not set(face) & set(roof)]
    return tuple(min(below, key=lambda face: float(shape[list(face), 1].mean()))) if below else ()


def raise_cabin(view: LabelledView, belt: tuple[int, ...], factor: float) -> LabelledView:
    """The car with everything above its belt stretched upwards, and the image taller accordingly.

    Args:
        view: The car; returned as it is where the belt is unknown or far from level.
        belt: Keypoints of the belt.
        factor: From 1.
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
        view, image=np.asarray(image), mask=np.asarray(mask), keypoints=moved + np.array([0.0, by]), within=within
    )
