"""Energy terms of the pose search, evaluated for many poses at once.

The search compares H hypotheses (pose and shape coefficients) in one vectorised Levenberg-Marquardt; the factor graph
of `fgrecon.solve.graph` then refines what matters with the same terms and more. Residuals and derivatives are those of
`factors` (`projection`, `box`, `ground`), for H poses at once. Each term adds to the energy (nats), the
gradient and the Gauss-Newton matrix of the 6 + N local coordinates: rotation about the object's own axes (right
perturbation, radians), translation in the camera frame (metres), coefficients.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from factors.box import extents_by_points, soft_extents
from factors.ground import ground_rows
from factors.projection import by_pose, pixel_jacobian, project
from fgrecon.core.camera import MIN_DEPTH, Ground
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

    @classmethod
    def joined(cls, parts: Sequence[Hypotheses]) -> Hypotheses:
        """Those of all parts, one after the other."""
        return cls(
            np.concatenate([part.rotation for part in parts]),
            np.concatenate([part.translation for part in parts]),
            np.concatenate([part.coefficients for part in parts]),
        )

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
    pixels, camera, depths = project(matrix, h.rotation, h.translation, points, MIN_DEPTH)
    any_near: NDArray[np.bool_] = np.any(depths < MIN_DEPTH, axis=1)
    return pixels, camera, any_near


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

    @property
    def triangles(self) -> Array:
        """(K, 3) entries a, b, c of the whiteners [[a, 0], [b, c]]."""
        return np.ascontiguousarray(self.whitener.reshape(-1, 4)[:, [0, 2, 3]])

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
        by_turn, by_object = by_pose(points, h.rotation, by_camera)
        jacobian = np.concatenate([by_turn, by_camera, by_object @ self.basis.transpose(1, 2, 0)], axis=-1)
        count, size = len(h), len(self.mean)
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

    def packed(self) -> tuple[Any, ...]:
        """Arguments of the compiled kernel."""
        return (
            np.ascontiguousarray(self.mean),
            np.ascontiguousarray(self.basis).reshape(len(self.basis), 3 * len(self.mean)),
            np.ascontiguousarray(self.edges, dtype=np.float64),
            np.ascontiguousarray(self.used).view(np.uint8),
            self.sigma,
            self.outlier,
            self.softness,
        )

    def residuals(self, h: Hypotheses) -> Array:
        """Whitened residuals (H, 4)."""
        pixels = _project(self.matrix, self._points(h), h)[0]
        return (soft_extents(pixels, self.softness)[0] - self.edges) / self.sigma

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
        extents, share = soft_extents(pixels, self.softness)
        residual = (extents - self.edges) / self.sigma
        total.energy += np.where(near, np.inf, self.energy(residual))
        scale = np.sqrt(self.weights(residual))
        share = share * (scale / self.sigma)[..., None]
        total.add(residual * scale, self._jacobian(points, camera, share, h))

    def _jacobian(self, points: Array, camera: Array, share: Array, h: Hypotheses) -> Array:
        """(H, 4, 6 + N) derivative of the edges, for their derivative `share` (H, 4, P) by each point's pixel."""
        turn, shift, by_point = extents_by_points(self.matrix, camera, h.rotation, points, share)
        flat_basis = self.basis.transpose(0, 2, 1).reshape(len(self.basis), 3 * len(self.mean))
        by_coefficients = by_point.reshape(len(h), 4, 3 * len(self.mean)) @ flat_basis.T
        return np.concatenate([turn, shift @ h.rotation.transpose(0, 2, 1), by_coefficients], axis=-1)

    def _points(self, h: Hypotheses) -> Array:
        points: Array = self.mean + np.tensordot(h.coefficients, self.basis, axes=1)
        return points


@dataclass(frozen=True)
class SizeTerm:
    """Box dimensions against a fleet's (E_dim of the paper): mean (3,), jacobian (3, N) of length, width, height."""

    mean: Array
    jacobian: Array
    prior: SizePrior

    def packed(self) -> tuple[Array, Array, Array]:
        """Arguments of the compiled kernel."""
        return self.mean - self.prior.mean, np.ascontiguousarray(self.jacobian), self.prior.told

    def add(self, total: Quadratic, h: Hypotheses) -> None:
        """Add this term."""
        residual = (self.mean + h.coefficients @ self.jacobian.T - self.prior.mean) / self.prior.told
        jacobian = np.broadcast_to(self.jacobian / self.prior.told[:, None], (len(h), *self.jacobian.shape))
        total.energy += 0.5 * np.square(residual).sum(axis=1)
        total.add(residual, jacobian, slice(6, None))


@dataclass(frozen=True)
class GroundTerm:
    """The object's origin on the ground plane, its down axis along the plane's normal (`factors.ground`)."""

    ground: Ground

    def packed(self) -> tuple[Any, ...]:
        """Arguments of the compiled kernel."""
        ground = self.ground
        return ground.normal, ground.distance, ground.height_sigma, ground.slope_sigma, ground.tilt_sigma

    def add(self, total: Quadratic, h: Hypotheses) -> None:
        """Add this term."""
        ground = self.ground
        sigma = ground.height_sigma_at(h.translation[:, 2])
        residual, by_turn = ground_rows(ground.normal, ground.distance, h.rotation, h.translation)
        scale = np.stack([1.0 / sigma, *[np.full(len(h), 1.0 / ground.tilt_sigma)] * 3], axis=1)
        residual *= scale
        jacobian = np.zeros((len(h), 4, 6))
        jacobian[..., :3] = by_turn * scale[..., None]
        jacobian[:, 0, 3:] = ground.normal / sigma[:, None]
        total.energy += 0.5 * np.square(residual).sum(axis=1) + np.log(sigma)
        total.add(residual, jacobian, slice(0, 6))


def coefficient_term(total: Quadratic, h: Hypotheses) -> None:
    """Add the prior lambda ~ N(0, I)."""
    index = np.arange(6, 6 + h.coefficients.shape[1])
    total.energy += 0.5 * np.square(h.coefficients).sum(axis=1)
    total.gradient[:, 6:] += h.coefficients
    total.matrix[:, index, index] += 1.0
