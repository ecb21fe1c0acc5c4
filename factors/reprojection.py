"""Reprojection of keypoints: E_reproj of the paper's section III-C, in pixels.

    r_i = pi(K (R X_i(lambda, offsets) + t)) - x_i

The kernel decides what is a variable: pose and shape together, the shape at a fixed pose, or the pose of a fixed shape.
All keypoints of a frame are one stacked factor, whose noise model carries their weights row by row
(`stacked_reprojection_factor`); or each has a thin factor of its own, as GTSAM's robust noise models want it, which
weigh the norm of a whole factor. GTSAM hands a copy of all values to every callback of an optimisation, so that thin
factors grow dearer with the number of frames in the graph; stacked ones hardly do. A keypoint that was not found, or
has no weight, is left out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import gtsam
import numpy as np
from numpy.typing import ArrayLike, NDArray

from factors.checks import finite_array
from factors.errors import DegenerateProblemError, InvalidInputError
from factors.guard import Evaluation, guarded_factor
from factors.kernel import ProjectionKernel
from factors.losses import RobustLoss
from factors.noise import Noise, keypoint_whiteners

__all__ = ["reprojection_factor", "reprojection_factors", "stacked_reprojection_factor"]

_TINY = 1e-150  # a residual of this length is zero


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
    kernel: ProjectionKernel,
    pixels: ArrayLike,
    weights: ArrayLike,
    sigma: float,
    *,
    covariances: ArrayLike | None = None,
    robust: RobustLoss | None = None,
) -> gtsam.CustomFactor:
    """Reprojection errors of all keypoints in one factor, each with its own weight.

    The same energy and the same linear system as `reprojection_factors` with `factors.noise.keypoint_noise`, at the
    price of one callback. The weights are in the factor's noise model: sigma / sqrt(w_i) for both rows of a keypoint,
    or blocks Sigma_i / w_i where the keypoints have covariances. To change them build the factor again.

    With a robust loss the rows are whitened by the callback instead, and the noise model is of unit variance: GTSAM's
    robust noise models report the loss when asked for the error, and a residual weighted by rho'(s) / s when asked to
    linearise; this factor then does so for every keypoint, and ``unwhitenedError`` gives sqrt(2 rho(s_i)) in the
    direction of each residual.

    Args:
        kernel: Projects all keypoints.
        pixels: (K, 2) where they were seen; NaN rows for those that were not.
        weights: (K,) IRLS weights w_i >= 0; keypoints of weight zero are left out.
        sigma: Standard deviation sigma_0 of a keypoint of weight 1, pixels; not used where covariances are given.
        covariances: (K, 2, 2) covariance of each keypoint, pixels^2, or None.
        robust: Robust loss around every keypoint, or None.

    Returns:
        A factor with 2 rows (u, v) for each of the M keypoints that remain: pixels, or whitened with a robust loss.

    Raises:
        InvalidInputError: An array has the wrong shape, a weight is negative, sigma is not positive, or a covariance is
            not symmetric positive definite.
        DegenerateProblemError: No keypoint remains.
    """
    size = kernel.shape.size
    array = np.asarray(pixels, dtype=np.float64)
    if array.shape != (size, 2):
        raise InvalidInputError("pixels", f"shape {array.shape}", f"Give {size} pixels.")
    roots = keypoint_whiteners(finite_array("weights", weights, (size,)), sigma, covariances)
    used = np.flatnonzero(~np.isnan(array).any(axis=1) & (roots[:, 0] > 0))
    if not len(used):
        raise DegenerateProblemError("weights", "no keypoint with a pixel and a weight", "Give some weight.")
    seen = finite_array("pixels", array[used], (None, 2))
    if robust is None:
        noise: Noise = _stacked_noise(roots[used])
        callback: _StackedReprojection | _RobustReprojection = _StackedReprojection(kernel, used, seen)
    else:
        noise, callback = 1.0, _RobustReprojection(kernel, used, seen, roots[used], robust)
    return guarded_factor("stacked reprojection", noise, kernel.keys, kernel.dims, 2 * len(used), callback)


def _stacked_noise(whiteners: NDArray[np.float64]) -> gtsam.noiseModel.Gaussian:
    """Noise model of all rows from whiteners (M, 3) as `keypoint_whiteners` gives them."""
    if not whiteners[:, 1].any() and (whiteners[:, 0] == whiteners[:, 2]).all():
        return gtsam.noiseModel.Diagonal.Sigmas(np.repeat(1.0 / whiteners[:, 0], 2))
    matrix = np.zeros((2 * len(whiteners), 2 * len(whiteners)))
    first = np.arange(0, len(matrix), 2)
    # GTSAM wants the upper triangle: the transposed inverse of the other square root of the same information.
    a, b, c = whiteners.T
    information = np.sqrt(a * a + b * b)
    matrix[first, first] = information
    matrix[first, first + 1] = b * c / information
    matrix[first + 1, first + 1] = np.sqrt(np.maximum(c * c - (b * c / information) ** 2, 0.0))
    return gtsam.noiseModel.Gaussian.SqrtInformation(matrix)


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
        return residual, projection.jacobian[self.keypoints].reshape(residual.size, -1)


@dataclass(frozen=True, slots=True)
class _RobustReprojection:
    """Whiteners are lower triangular, [[a, 0], [b, c]], one row (a, b, c) for each of the M keypoints."""

    kernel: ProjectionKernel
    keypoints: NDArray[np.intp]
    pixels: NDArray[np.float64]
    whiteners: NDArray[np.float64]
    robust: RobustLoss

    def __call__(self, values: gtsam.Values, want_jacobian: bool) -> Evaluation:
        projection = self.kernel.evaluate(values, want_jacobian)
        whitened = _whiten(projection.pixels[self.keypoints] - self.pixels, self.whiteners)
        distances = np.sqrt(np.square(whitened).sum(axis=1, keepdims=True))
        if not want_jacobian or projection.jacobian is None:
            whitened *= np.sqrt(2.0 * self.robust.losses(distances)) / np.maximum(distances, _TINY)
            return whitened.ravel(), None
        roots = np.sqrt(self.robust.weights(distances))
        jacobian = _whiten(projection.jacobian[self.keypoints], (self.whiteners * roots)[:, :, None])
        return (whitened * roots).ravel(), jacobian.reshape(whitened.size, -1)


def _whiten(pairs: NDArray[np.float64], whiteners: NDArray[np.float64]) -> NDArray[np.float64]:
    """Multiply pairs (M, 2, ...) by lower triangular whiteners (M, 3, ...)."""
    result = np.empty_like(pairs)
    np.multiply(pairs[:, 0], whiteners[:, 0], out=result[:, 0])
    np.multiply(pairs[:, 1], whiteners[:, 2], out=result[:, 1])
    result[:, 1] += pairs[:, 0] * whiteners[:, 1]
    return result
