"""Energy terms of the pose search, evaluated for many poses at once.

The search compares H hypotheses (pose and shape coefficients) in one vectorised Levenberg-Marquardt; the factor graph
of `fgrecon.solve.graph` then refines what matters with the same terms and more. The rows are those of its factors
(`factors.keypoint_rows`, `factors.box`, `factors.ground`). Each term adds to the energy (nats), the gradient and the
Gauss-Newton matrix of the 6 + N local coordinates: rotation about the object's own axes (right perturbation, radians),
translation in the camera frame (metres), coefficients.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from factors.box import BoxRows, extents_by_points, soft_extents
from factors.ground import GroundRows
from factors.keypoint_rows import KeypointRows
from factors.projection import by_pose, pixel_jacobian, project
from fgrecon.core.arrays import Array
from fgrecon.core.camera import MIN_DEPTH, Ground
from fgrecon.core.detection import at_direction
from fgrecon.core.geometry import view_azimuth
from fgrecon.core.robust import Evidence, RobustStrategy
from fgrecon.core.size_prior import SizePrior
from fgrecon.solve.proposals.search_settings import SETTINGS


@dataclass(frozen=True)
class Hypotheses:
    """H poses with coefficients: rotation (H, 3, 3) and translation (H, 3) of camera_T_object, coefficients (H, N)."""

    rotation: Array
    translation: Array
    coefficients: Array

    @classmethod
    def at_poses(cls, camera_T_object: ArrayLike, dimension: int) -> Hypotheses:
        """Known poses (H, 4, 4) with the mean shape of a prior of so many coefficients."""
        poses = np.asarray(camera_T_object, dtype=np.float64).reshape(-1, 4, 4)
        return cls(poses[:, :3, :3].copy(), poses[:, :3, 3].copy(), np.zeros((len(poses), dimension)))

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

    def of_dimension(self, count: int) -> Hypotheses:
        """The same with the first so many coefficients alone, or with further ones, which are zero."""
        coefficients = np.zeros((len(self), count))
        kept = self.coefficients[:, :count]
        coefficients[:, : kept.shape[1]] = kept
        return Hypotheses(self.rotation, self.translation, coefficients)

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


@dataclass(frozen=True)
class KeypointTerm:
    """Robust reprojection error of the keypoints (E_reproj of the paper with IRLS weights)."""

    mean: Array  # (K, 3) mean keypoints
    basis: Array  # (N, K, 3) basis
    matrix: Array  # (3, 3) camera matrix
    rows: KeypointRows  # measured pixels and whiteners
    evidence: Evidence  # confidences
    strategy: RobustStrategy
    name: ClassVar[str] = "reprojection"

    def residuals(self, h: Hypotheses) -> tuple[Array, Array, Array, NDArray[np.bool_]]:
        """Whitened residuals (H, K, 2), object points, camera points, and whether a point is too near."""
        points = self.mean + np.tensordot(h.coefficients, self.basis, axes=1)
        pixels, camera, depths = project(self.matrix, h.rotation, h.translation, points, MIN_DEPTH)
        return self.rows.residual(pixels), points, camera, np.any(depths < MIN_DEPTH, axis=1)

    def add(self, total: Quadratic, h: Hypotheses, visibility: Array, progress: float) -> Array:
        """Add this term; the weights (H, K)."""
        residual, points, camera, near = self.residuals(h)
        squared = np.square(residual).sum(axis=-1)
        weights, energy = self.strategy.evaluate(squared, self.evidence, visibility, progress=progress)
        total.energy += np.where(near, np.inf, energy)
        scale = np.sqrt(weights)
        by_camera = self.rows.whiten(pixel_jacobian(self.matrix, camera)) * scale[..., None, None]
        by_turn, by_object = by_pose(points, h.rotation, by_camera)
        jacobian = np.concatenate([by_turn, by_camera, by_object @ self.basis.transpose(1, 2, 0)], axis=-1)
        count, size = len(h), len(self.mean)
        total.add((residual * scale[..., None]).reshape(count, 2 * size), jacobian.reshape(count, 2 * size, -1))
        return weights


@dataclass(frozen=True)
class BoxTerm:
    """The edges of the 2D box against the extents of projected points, each edge with its own inlier weight."""

    mean: Array  # (P, 3) points whose extents the box encloses
    basis: Array  # (N, P, 3) their basis
    matrix: Array  # (3, 3) camera matrix
    rows: BoxRows
    name: ClassVar[str] = "box"

    @property
    def packed(self) -> tuple[Any, ...]:
        """Arguments of the compiled kernel."""
        rows = self.rows
        return (
            np.ascontiguousarray(self.mean),
            np.ascontiguousarray(self.basis).reshape(len(self.basis), 3 * len(self.mean)),
            _by_point(self.basis),
            np.ascontiguousarray(rows.soft_edges, dtype=np.float64),
            np.ascontiguousarray(rows.used).view(np.uint8),
            rows.sigma,
            rows.wrong,
            rows.softness,
        )

    def residuals(self, h: Hypotheses) -> Array:
        """Whitened residuals (H, 4)."""
        return self.rows.residual(soft_extents(self._project(h)[0], self.rows.softness)[0])

    def add(self, total: Quadratic, h: Hypotheses) -> None:
        """Add this term."""
        pixels, camera, depths, points = self._project(h)
        extents, share = soft_extents(pixels, self.rows.softness)
        residual = self.rows.residual(extents)
        weights, _, energy = self.rows.assess(residual)
        total.energy += np.where(np.any(depths < MIN_DEPTH, axis=1), np.inf, energy)
        scale = np.sqrt(weights)
        share = share * (scale / self.rows.sigma)[..., None]
        turn, shift, by_point = extents_by_points(self.matrix, camera, h.rotation, points, share)
        flat_basis = self.basis.transpose(0, 2, 1).reshape(len(self.basis), 3 * len(self.mean))
        by_coefficients = by_point.reshape(len(h), 4, 3 * len(self.mean)) @ flat_basis.T
        jacobian = np.concatenate([turn, shift @ h.rotation.transpose(0, 2, 1), by_coefficients], axis=-1)
        total.add(residual * scale, jacobian)

    def _project(self, h: Hypotheses) -> tuple[Array, Array, Array, Array]:
        """Pixels (H, P, 2), camera points, depths (H, P) and object points."""
        points: Array = self.mean + np.tensordot(h.coefficients, self.basis, axes=1)
        return *project(self.matrix, h.rotation, h.translation, points, MIN_DEPTH), points


_BY_POINT: dict[int, tuple[Array, Array]] = {}
"""Bases of the last few models, and what `_by_point` makes of them, by their identity."""
_MODELS = 16


def _by_point(basis: Array) -> Array:
    """(P, 3, N) of a basis (N, P, 3), which thousands of vehicles share."""
    known = _BY_POINT.get(id(basis))
    if known is None or known[0] is not basis:
        if len(_BY_POINT) >= _MODELS:
            _BY_POINT.clear()
        known = _BY_POINT[id(basis)] = basis, np.ascontiguousarray(basis.transpose(1, 2, 0))
    return known[1]


@dataclass(frozen=True)
class SizeTerm:
    """Box dimensions against a fleet's (E_dim of the paper): mean (3,), jacobian (3, N) of length, width, height."""

    mean: Array
    jacobian: Array
    prior: SizePrior
    name: ClassVar[str] = "dimensions"

    @property
    def packed(self) -> tuple[Array, Array, Array]:
        """Arguments of the compiled kernel."""
        return self.mean - self.prior.mean, np.ascontiguousarray(self.jacobian), self.prior.assumed_sigma

    def add(self, total: Quadratic, h: Hypotheses) -> None:
        """Add this term."""
        residual = (self.mean + h.coefficients @ self.jacobian.T - self.prior.mean) / self.prior.assumed_sigma
        jacobian = np.broadcast_to(self.jacobian / self.prior.assumed_sigma[:, None], (len(h), *self.jacobian.shape))
        total.energy += 0.5 * np.square(residual).sum(axis=1)
        total.add(residual, jacobian, slice(6, None))


@dataclass(frozen=True)
class GroundTerm:
    """The object's origin on the ground plane, its down axis along the plane's normal (`factors.ground`)."""

    ground: Ground
    name: ClassVar[str] = "ground"

    @cached_property
    def rows(self) -> GroundRows:
        """What has the residuals."""
        return GroundRows(self.ground.normal, self.ground.distance, self.ground.tilt_sigma)

    @property
    def packed(self) -> tuple[Any, ...]:
        """Arguments of the compiled kernel."""
        ground = self.ground
        return ground.normal, ground.distance, ground.height_sigma, ground.slope_sigma, ground.tilt_sigma

    def add(self, total: Quadratic, h: Hypotheses) -> None:
        """Add this term."""
        sigma = self.ground.height_sigma_at(h.translation[:, 2])
        residual, by_turn, by_shift = self.rows.whitened(h.rotation, h.translation, sigma)
        jacobian = np.zeros((len(h), 4, 6))
        jacobian[..., :3], jacobian[:, 0, 3:] = by_turn, by_shift
        total.energy += 0.5 * np.square(residual).sum(axis=1) + np.log(sigma)
        total.add(residual, jacobian, slice(0, 6))


@dataclass(frozen=True)
class DirectionTerm:
    """From which direction a vehicle is observed: minus the logarithm of its probability, 0 for the most probable one.

    Keypoints of a car from ahead and of one from behind can look much alike: both poses are minima of the
    energy, and the wrong one may be a few nats lower. This term decides between them. Within one minimum the keypoints
    tell the direction far better, so it has no gradient.
    """

    azimuth: Array  # (A,) probability of each direction, as in `fgrecon.core.observation.Observation`
    name: ClassVar[str] = "direction"

    @property
    def probability(self) -> Array:
        """(A,) probability of each direction, relative to the greatest, with what the detector may be wrong by."""
        meaningless = SETTINGS.direction_meaningless_probability
        probability = (1.0 - meaningless) * self.azimuth + meaningless / len(self.azimuth)
        return probability / probability.max()

    def energy(self, h: Hypotheses) -> Array:
        """(H,) energies of the hypotheses, nats."""
        here = at_direction(self.probability, view_azimuth(h.rotation, h.translation))
        return np.asarray(-np.log(here), dtype=np.float64)

    def add(self, total: Quadratic, h: Hypotheses) -> None:
        """Add this term: energies alone."""
        total.energy += self.energy(h)


@dataclass(frozen=True)
class CoefficientTerm:
    """The prior lambda ~ N(0, I)."""

    name: ClassVar[str] = "coefficients"

    def add(self, total: Quadratic, h: Hypotheses) -> None:
        """Add this term."""
        index = np.arange(6, 6 + h.coefficients.shape[1])
        total.energy += 0.5 * np.square(h.coefficients).sum(axis=1)
        total.gradient[:, 6:] += h.coefficients
        total.matrix[:, index, index] += 1.0


def direction_penalty(azimuth: Array | None, camera_T_object: ArrayLike) -> float:
    """What a pose (4, 4) costs by the directions (A,), nats; 0 where none are given."""
    if azimuth is None:
        return 0.0
    pose = np.asarray(camera_T_object, dtype=np.float64)
    return float(DirectionTerm(azimuth).energy(Hypotheses(pose[None, :3, :3], pose[None, :3, 3], np.zeros((1, 0))))[0])
