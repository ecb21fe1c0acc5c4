"""Energy terms of the pose search, evaluated for many poses at once.

The search compares H hypotheses (pose and shape coefficients) in one vectorised Levenberg-Marquardt; the factor graph
of `fgrecon.solve.graph` then refines the winner with the same terms and more. Each term adds to the energy (nats), the
gradient and the Gauss-Newton matrix of the 6 + N local coordinates: rotation about the object's own axes (right
perturbation, radians), translation in the camera frame (metres), coefficients.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.camera import MIN_DEPTH, Ground
from fgrecon.core.geometry import cross, pixel_jacobian
from fgrecon.core.robust import Evidence, RobustStrategy
from fgrecon.core.size_prior import SizePrior

__all__ = ["BoxTerm", "GroundTerm", "Hypotheses", "KeypointTerm", "Quadratic", "SizeTerm", "coefficient_term"]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Hypotheses:
    """H poses with coefficients: rotation (H, 3, 3) and translation (H, 3) of camera_T_object, coefficients (H, N)."""

    rotation: Array
    translation: Array
    coefficients: Array

    def __len__(self) -> int:
        """Number of hypotheses."""
        return len(self.rotation)

    def take(self, index: NDArray[np.intp] | NDArray[np.bool_]) -> Hypotheses:
        """The hypotheses at an index or mask."""
        return Hypotheses(self.rotation[index], self.translation[index], self.coefficients[index])

    def where(self, mask: NDArray[np.bool_], other: Hypotheses) -> Hypotheses:
        """`self` where the mask holds, `other` elsewhere."""
        return Hypotheses(
            np.where(mask[:, None, None], self.rotation, other.rotation),
            np.where(mask[:, None], self.translation, other.translation),
            np.where(mask[:, None], self.coefficients, other.coefficients),
        )

    def matrices(self) -> Array:
        """(H, 4, 4) camera_T_object."""
        result = np.zeros((len(self), 4, 4))
        result[:, :3, :3], result[:, :3, 3], result[:, 3, 3] = self.rotation, self.translation, 1.0
        return result


class Quadratic:
    """Sum of the terms: energy (H,), gradient (H, D) and Gauss-Newton matrix (H, D, D)."""

    def __init__(self, count: int, dimension: int) -> None:
        self.energy = np.zeros(count)
        self.gradient = np.zeros((count, dimension))
        self.matrix = np.zeros((count, dimension, dimension))

    def add(self, residual: Array, jacobian: Array, columns: slice = slice(None)) -> None:
        """Add rows: whitened residuals (H, R) and their Jacobian (H, R, columns)."""
        transposed = jacobian.transpose(0, 2, 1)
        self.matrix[:, columns, columns] += transposed @ jacobian
        self.gradient[:, columns] += (transposed @ residual[..., None])[..., 0]

    def take(self, index: NDArray[np.intp]) -> Quadratic:
        """The sums of some of the hypotheses."""
        taken = Quadratic(0, 0)
        taken.energy, taken.gradient, taken.matrix = self.energy[index], self.gradient[index], self.matrix[index]
        return taken

    def update(self, mask: NDArray[np.bool_], other: Quadratic) -> None:
        """Take over another's sums where the mask holds."""
        self.energy[mask] = other.energy[mask]
        self.gradient[mask] = other.gradient[mask]
        self.matrix[mask] = other.matrix[mask]


def _project(matrix: Array, points: Array, h: Hypotheses) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Pixels (H, P, 2) of object points (H, P, 3), camera points, and whether any is too near (H,)."""
    camera = points @ h.rotation.transpose(0, 2, 1) + h.translation[:, None]
    near = camera[..., 2] < MIN_DEPTH
    camera[..., 2] = np.where(near, MIN_DEPTH, camera[..., 2])
    homogeneous = camera @ matrix.T
    any_near: NDArray[np.bool_] = np.any(near, axis=1)
    return homogeneous[..., :2] / homogeneous[..., 2:], camera, any_near


@dataclass(frozen=True)
class KeypointTerm:
    """Robust reprojection error of the keypoints (E_reproj of the paper with IRLS weights).

    Attributes:
        mean: (K, 3) mean keypoints.
        basis: (N, K, 3) basis.
        matrix: (3, 3) camera matrix.
        pixels: (K, 2) measured pixels, any finite number where not measured.
        whitener: (K, 2, 2) inverse Cholesky factors of the keypoints' covariances.
        evidence: Confidences.
        strategy: Robust strategy.
    """

    mean: Array
    basis: Array
    matrix: Array
    pixels: Array
    whitener: Array
    evidence: Evidence
    strategy: RobustStrategy

    def residuals(self, h: Hypotheses) -> tuple[Array, Array, Array, NDArray[np.bool_]]:
        """Whitened residuals (H, K, 2), object points, camera points, and whether a point is too near."""
        points = self.mean + np.tensordot(h.coefficients, self.basis, axes=1)
        pixels, camera, near = _project(self.matrix, points, h)
        residual = (self.whitener @ (pixels - self.pixels)[..., None])[..., 0]
        return residual, points, camera, near

    def add(self, total: Quadratic, h: Hypotheses, visibility: Array, progress: float) -> Array:
        """Add this term; the weights (H, K)."""
        residual, points, camera, near = self.residuals(h)
        squared = np.square(residual).sum(axis=-1)
        weights, energy = self.strategy.evaluate(squared, self.evidence, visibility, progress=progress)
        total.energy += np.where(near, np.inf, energy)
        scale = np.sqrt(weights)
        by_camera = self.whitener @ pixel_jacobian(self.matrix, camera) * scale[..., None, None]
        count, size = len(h), len(self.mean)
        by_object = (by_camera.reshape(count, 2 * size, 3) @ h.rotation).reshape(count, size, 2, 3)
        jacobian = np.concatenate(
            [cross(points[:, :, None, :], by_object), by_camera, by_object @ self.basis.transpose(1, 2, 0)], axis=-1
        )
        total.add((residual * scale[..., None]).reshape(count, 2 * size), jacobian.reshape(count, 2 * size, -1))
        return weights


@dataclass(frozen=True)
class BoxTerm:
    """The edges of the 2D box against the extents of projected points, each edge with its own inlier weight.

    Attributes:
        mean: (P, 3) points whose extents the box encloses.
        basis: (N, P, 3) their basis.
        matrix: (3, 3) camera matrix.
        edges: (4,) x1, y1, x2, y2.
        used: (4,) which edges count; an edge on the image border does not.
        sigma: Standard deviation of an edge, pixels.
        outlier: Density of a wrong edge relative to a right one's peak, times the odds of being wrong.
        softness: Pixels over which one outermost point hands over to the next, see `factors.box`.
    """

    mean: Array
    basis: Array
    matrix: Array
    edges: Array
    used: NDArray[np.bool_]
    sigma: float
    outlier: float
    softness: float

    def residuals(self, h: Hypotheses) -> Array:
        """Whitened residuals (H, 4)."""
        pixels = _project(self.matrix, self._points(h), h)[0]
        return (self._extents(pixels)[0] - self.edges) / self.sigma

    def weights(self, residual: Array) -> Array:
        """(H, 4) probability that each edge is right."""
        inlier = np.exp(-0.5 * np.square(residual))
        return np.where(self.used, inlier / (inlier + self.outlier), 0.0)

    def energy(self, residual: Array) -> Array:
        """(H,) negative logarithm of the edges' likelihood, nats."""
        likelihood = np.exp(-0.5 * np.square(residual)) + self.outlier
        total: Array = -np.where(self.used, np.log(likelihood), 0.0).sum(axis=1)
        return total

    def add(self, total: Quadratic, h: Hypotheses) -> None:
        """Add this term."""
        points = self._points(h)
        pixels, camera, near = _project(self.matrix, points, h)
        extents, share = self._extents(pixels)
        residual = (extents - self.edges) / self.sigma
        total.energy += np.where(near, np.inf, self.energy(residual))
        scale = np.sqrt(self.weights(residual))
        share = share * (scale / self.sigma)[..., None]
        total.add(residual * scale, self._jacobian(points, camera, share, h))

    def _jacobian(self, points: Array, camera: Array, share: Array, h: Hypotheses) -> Array:
        """(H, 4, 6 + N) derivative of the edges, for their derivative `share` (H, 4, P) by each point's pixel.

        Points come last in memory, and sums over them are one product: with g_p the derivative of an edge by the object
        point X_p, sum_p g_p (X_p, 1)' holds that by the translation, and in its antisymmetric part X_p x g_p, that by
        the turn.
        """
        count, size = len(h), len(self.mean)
        inverse = 1.0 / camera[..., 2]
        x, y = camera[..., 0] * inverse, camera[..., 1] * inverse
        gradient = np.zeros((count, 2, 3, size))
        gradient[:, 0, 0] = self.matrix[0, 0] * inverse
        gradient[:, 0, 1] = self.matrix[0, 1] * inverse
        gradient[:, 1, 1] = self.matrix[1, 1] * inverse
        gradient[:, 0, 2] = -(self.matrix[0, 0] * x + self.matrix[0, 1] * y) * inverse
        gradient[:, 1, 2] = -self.matrix[1, 1] * y * inverse
        gradient = h.rotation.transpose(0, 2, 1)[:, None] @ gradient
        by_point = (share.reshape(count, 2, 2, 1, size) * gradient[:, None]).reshape(count, 4, 3, size)
        homogeneous = np.ones((count, 1, size, 4))
        homogeneous[:, 0, :, :3] = points
        moment = by_point @ homogeneous
        jacobian = np.empty((count, 4, 6 + len(self.basis)))
        jacobian[..., 0] = moment[..., 2, 1] - moment[..., 1, 2]
        jacobian[..., 1] = moment[..., 0, 2] - moment[..., 2, 0]
        jacobian[..., 2] = moment[..., 1, 0] - moment[..., 0, 1]
        jacobian[..., 3:6] = moment[..., 3] @ h.rotation.transpose(0, 2, 1)
        flat_basis = self.basis.transpose(0, 2, 1).reshape(len(self.basis), 3 * size)
        jacobian[..., 6:] = by_point.reshape(count, 4, 3 * size) @ flat_basis.T
        return jacobian

    def _points(self, h: Hypotheses) -> Array:
        points: Array = self.mean + np.tensordot(h.coefficients, self.basis, axes=1)
        return points

    def _extents(self, pixels: Array) -> tuple[Array, Array]:
        """Extents (H, 4) of pixels (H, P, 2), and their derivative (H, 4, P) by the pixels of their axis."""
        upright = pixels.transpose(0, 2, 1)
        outward = np.concatenate([-upright, upright], axis=1)  # (H, 4, P): x1, y1, x2, y2
        # Beyond 40 softnesses a weight is below the rounding of the sum; numbers near the smallest float are slow.
        weight = np.exp(np.maximum((outward - outward.max(axis=2, keepdims=True)) / self.softness, -40.0))
        weight /= weight.sum(axis=2, keepdims=True)
        extent = (weight * outward).sum(axis=2)
        share = weight * (1.0 + (outward - extent[..., None]) / self.softness)
        return extent * np.array([-1.0, -1.0, 1.0, 1.0]), share


@dataclass(frozen=True)
class SizeTerm:
    """Box dimensions against a fleet's (E_dim of the paper): mean (3,), jacobian (3, N) of length, width, height."""

    mean: Array
    jacobian: Array
    prior: SizePrior

    def add(self, total: Quadratic, h: Hypotheses) -> None:
        """Add this term."""
        residual = (self.mean + h.coefficients @ self.jacobian.T - self.prior.mean) / self.prior.sigma
        jacobian = np.broadcast_to(self.jacobian / self.prior.sigma[:, None], (len(h), *self.jacobian.shape))
        total.energy += 0.5 * np.square(residual).sum(axis=1)
        total.add(residual, jacobian, slice(6, None))


@dataclass(frozen=True)
class GroundTerm:
    """The object's origin on the ground plane, its down axis along the plane's normal (`factors.ground`)."""

    ground: Ground

    def add(self, total: Quadratic, h: Hypotheses) -> None:
        """Add this term."""
        ground = self.ground
        sigma = ground.height_sigma_at(h.translation[:, 2])
        height = (h.translation @ ground.normal - ground.distance) / sigma
        lean = (h.rotation[:, :, 1] - ground.normal) / ground.tilt_sigma
        residual = np.concatenate([height[:, None], lean], axis=1)
        jacobian = np.zeros((len(h), 4, 6))
        jacobian[:, 0, 3:] = ground.normal / sigma[:, None]
        jacobian[:, 1:, 0] = h.rotation[..., 2] / ground.tilt_sigma  # d(R exp(w) e_y) = R (w x e_y) = R (-w_z, 0, w_x)
        jacobian[:, 1:, 2] = -h.rotation[..., 0] / ground.tilt_sigma
        total.energy += 0.5 * np.square(residual).sum(axis=1) + np.log(sigma)
        total.add(residual, jacobian, slice(0, 6))


def coefficient_term(total: Quadratic, h: Hypotheses) -> None:
    """Add the prior lambda ~ N(0, I)."""
    index = np.arange(6, 6 + h.coefficients.shape[1])
    total.energy += 0.5 * np.square(h.coefficients).sum(axis=1)
    total.gradient[:, 6:] += h.coefficients
    total.matrix[:, index, index] += 1.0
