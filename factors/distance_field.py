"""Signed distance of pixels from an outline, with its derivative; numpy alone, since masks have one without GTSAM."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from factors.arrays import Array


@dataclass(frozen=True, eq=False)
class DistanceField:
    """Signed distance from an outline, in pixels, over a part of the image."""

    corner: Array  # (2,) pixel (u, v) of the first number
    # (H, W) at pixels, at least 2 x 2; linear between them, and beyond as far as the pixel is from there
    distance: Array

    def at(self, pixels: Array) -> tuple[Array, Array]:
        """Distances (P,) at pixels (P, 2), and their derivatives (P, 2)."""
        height, width = self.distance.shape
        place = pixels - self.corner
        inside = np.clip(place, 0.0, [width - 1.0, height - 1.0])
        beyond = place - inside
        column, row = np.minimum(inside.astype(np.intp), [width - 2, height - 2]).T
        u, v = (inside - np.stack([column, row], axis=1)).T
        top, bottom = self.distance[row, column], self.distance[row + 1, column]
        along_top, along_bottom = self.distance[row, column + 1] - top, self.distance[row + 1, column + 1] - bottom
        upper, lower = top + u * along_top, bottom + u * along_bottom
        slope = np.stack([along_top + v * (along_bottom - along_top), lower - upper], axis=1)
        away = np.sqrt(np.square(beyond).sum(axis=1))
        outward = beyond / np.where(away > 0.0, away, 1.0)[:, None]
        return upper + v * (lower - upper) + away, np.where(beyond == 0.0, slope, 0.0) + outward
