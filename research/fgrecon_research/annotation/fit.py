"""A vehicle fitted to one of its images."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.geometry import transform
from fgrecon.core.reconstruction import Reconstruction
from fgrecon.core.shape_prior import ShapePrior
from fgrecon.solve.vehicle.visibility import occluder
from fgrecon_research.annotation.hidden import Solid

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Fit:
    """A vehicle in one image: where it is, where its keypoints are seen, and what it hides."""

    result: Reconstruction  # the reconstruction
    covariance: Array  # (K, 2, 2) of the projected keypoints, square pixels
    solid: Solid  # its surface in the camera's frame; where the prior has none, a hull made from the keypoints

    @classmethod
    def of(cls, result: Reconstruction, covariance: Array, prior: ShapePrior) -> Fit:
        """The fit of a result.

        Args:
            result: A result with a pose.
            covariance: (K, 2, 2) of the projected keypoints, square pixels.
            prior: The prior that the result's coefficients belong to.
        """
        surface = occluder(prior)
        vertices = transform(result.camera_T_object, surface.vertices(result.shape.coefficients))
        return cls(result, covariance, Solid(vertices, surface.faces.astype(np.int64)))

    @property
    def points(self) -> Array:
        """(K, 3) keypoints in the camera's frame, metres."""
        return transform(self.result.camera_T_object, self.result.wireframe)
