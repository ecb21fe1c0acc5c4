"""Reprojection of keypoints: E_reproj of the paper's section III-C, in pixels.

    r_i = pi(K (R X_i(lambda, offsets) + t)) - x_i

The kernel decides what is a variable: pose and shape together, the shape at a fixed pose, or the pose of a fixed shape.
One thin factor per keypoint keeps a robust weight of its own; one stacked factor is several times faster where none is
needed. A keypoint that was not found gets no factor.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import gtsam
import numpy as np
from numpy.typing import ArrayLike, NDArray

from factors.checks import finite_array, index_array
from factors.errors import InvalidInputError
from factors.guard import Evaluation, guarded_factor
from factors.kernel import ProjectionKernel
from factors.noise import Noise

__all__ = ["reprojection_factor", "reprojection_factors", "stacked_reprojection_factor"]


def reprojection_factor(kernel: ProjectionKernel, keypoint: int, pixel: ArrayLike, noise: Noise) -> gtsam.CustomFactor:
    """Reprojection error of one keypoint: 2 rows, pixels.

    Args:
        kernel: Projects all keypoints; shared by all factors of the frame.
        keypoint: Index of the keypoint.
        pixel: (2,) where it was seen, without lens distortion.
        noise: Noise model of dimension 2 (`factors.noise.keypoint_noise`), or one sigma in pixels.

    Raises:
        InvalidInputError: The index is out of range or the pixel is not finite.
    """
    if not 0 <= keypoint < kernel.shape.size:
        raise InvalidInputError("keypoint", keypoint, f"Give an index from 0 to {kernel.shape.size - 1}.")
    callback = _Reprojection(kernel, int(keypoint), finite_array("pixel", pixel, (2,)))
    return guarded_factor(f"reprojection of keypoint {keypoint}", noise, kernel.keys, kernel.dims, 2, callback)


def reprojection_factors(
    kernel: ProjectionKernel, pixels: ArrayLike, noises: Sequence[Noise | None]
) -> list[gtsam.CustomFactor]:
    """One thin factor for every keypoint that was found and has a weight.

    Args:
        kernel: Projects all keypoints.
        pixels: (K, 2) where they were seen; NaN rows for those that were not.
        noises: K noise models of dimension 2; None (weight zero) for a keypoint that gets no factor.

    Raises:
        InvalidInputError: There are not K pixels and noise models.
    """
    array = np.asarray(pixels, dtype=np.float64)
    if array.shape != (kernel.shape.size, 2) or len(noises) != kernel.shape.size:
        raise InvalidInputError("pixels", f"shape {array.shape}", f"Give {kernel.shape.size} pixels and noise models.")
    return [
        reprojection_factor(kernel, i, array[i], noise)
        for i, noise in enumerate(noises)
        if noise is not None and not np.isnan(array[i]).any()
    ]


def stacked_reprojection_factor(
    kernel: ProjectionKernel, keypoints: ArrayLike, pixels: ArrayLike, noise: Noise
) -> gtsam.CustomFactor:
    """Reprojection errors of M keypoints in one factor: 2M rows (u, v of each in turn), pixels.

    A robust loss around it weighs all keypoints as one.

    Args:
        kernel: Projects all keypoints.
        keypoints: (M,) their indices.
        pixels: (M, 2) where they were seen.
        noise: Noise model of dimension 2M (`factors.noise.stacked_noise`), or one sigma in pixels.

    Raises:
        InvalidInputError: An index is out of range or repeated, or a pixel is not finite.
    """
    indices = index_array("keypoints", keypoints, kernel.shape.size)
    callback = _StackedReprojection(kernel, indices, finite_array("pixels", pixels, (len(indices), 2)))
    return guarded_factor("stacked reprojection", noise, kernel.keys, kernel.dims, 2 * len(indices), callback)


@dataclass(frozen=True, slots=True)
class _Reprojection:
    kernel: ProjectionKernel
    keypoint: int
    pixel: NDArray[np.float64]

    def __call__(self, values: gtsam.Values, want_jacobian: bool) -> Evaluation:
        projection = self.kernel.evaluate(values, want_jacobian)
        jacobian = projection.jacobian
        i = self.keypoint
        return projection.pixels[i] - self.pixel, jacobian if jacobian is None else jacobian[i]


@dataclass(frozen=True, slots=True)
class _StackedReprojection:
    kernel: ProjectionKernel
    keypoints: NDArray[np.intp]
    pixels: NDArray[np.float64]

    def __call__(self, values: gtsam.Values, want_jacobian: bool) -> Evaluation:
        projection = self.kernel.evaluate(values, want_jacobian)
        residual = (projection.pixels[self.keypoints] - self.pixels).ravel()
        if not want_jacobian or projection.jacobian is None:
            return residual, None
        return residual, projection.jacobian[self.keypoints].reshape(len(residual), -1)
