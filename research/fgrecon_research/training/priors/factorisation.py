"""Rigid factorisation of image points with missing data: the start of NRSfM, which knows nothing of the category.

All instances are taken for one rigid shape under affine cameras (Tomasi and Kanade 1992; missing data by alternating
least squares, each instance scaled to unit size), inside the subspace of symmetric shapes where symmetry is imposed.
The affine ambiguity is then removed by asking for cameras with orthogonal rows of equal length.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.arrays import Array

_MIRROR = np.diag([1.0, 1.0, -1.0])
_MEDIAL = np.eye(3)[:, :2]


@dataclass(frozen=True)
class Orbit:
    """Keypoints that share their unknowns: a mirrored pair, a point on the medial plane, or one free point."""

    keypoints: NDArray[np.intp]  # (P,) their indices
    maps: NDArray[np.float64]  # (P, 3, D) from the D shared unknowns to each keypoint's coordinates

    @property
    def size(self) -> int:
        """Number of shared unknowns D."""
        return int(self.maps.shape[2])


@dataclass(frozen=True)
class SymmetricSubspace:
    """Shapes (K, 3) that equal their own mirror image about z = 0; every shape where symmetry is not imposed.

    A pair has the unknowns (x, y, z) of its left point, whose image is (x, y, -z); a keypoint without a partner lies
    on the medial plane and has (x, y). The rank of the mean and basis thus halves, and no coefficient can break the
    symmetry; mirrored copies of the data would impose it on the mean alone and cost twice the time.
    """

    orbits: tuple[Orbit, ...]  # the groups of keypoints, which together contain each keypoint once
    mirror: NDArray[np.intp] | None  # (K,) index of each keypoint's mirror image, or None where symmetry is not imposed

    @classmethod
    def of(cls, size: int, pairs: Sequence[tuple[int, int]], symmetric: bool) -> SymmetricSubspace:
        """The subspace for `size` keypoints and their pairs (left, right); without pairs nothing is imposed."""
        if not symmetric or not pairs:
            return cls(tuple(Orbit(np.array([k]), np.eye(3)[None]) for k in range(size)), None)
        mirror = np.arange(size)
        orbits = []
        for left, right in pairs:
            mirror[left], mirror[right] = right, left
            orbits.append(Orbit(np.array([left, right]), np.stack([np.eye(3), _MIRROR])))
        orbits += [Orbit(np.array([k]), _MEDIAL[None]) for k in range(size) if mirror[k] == k]
        return cls(tuple(orbits), mirror)

    def project(self, shapes: NDArray[np.float64]) -> NDArray[np.float64]:
        """The nearest shapes (..., K, 3) inside the subspace."""
        if self.mirror is None:
            return shapes
        return 0.5 * (shapes + shapes[..., self.mirror, :] @ _MIRROR)


def affine_factorisation(
    points: Array, measured: Array, subspace: SymmetricSubspace, rng: np.random.Generator, iterations: int = 200
) -> tuple[Array, Array, float]:
    """Shape and affine cameras by alternating least squares from a random start.

    Args:
        points: (M, K, 2) image points, each instance centred and scaled to unit size; zeros where unseen.
        measured: (M, K) 1.0 where annotated, else 0.0.
        subspace: Where the shape lives.
        iterations: Most alternations; it ends early when the error falls by less than 1e-6 of itself.

    Returns:
        The shape (K, 3), the cameras (M, 2, 3) and the mean squared error per seen keypoint.
    """
    shape = subspace.project(rng.standard_normal((points.shape[1], 3)))
    shape -= subspace.project(np.broadcast_to(shape.mean(axis=0), shape.shape))
    damping = 1e-3
    error = np.inf
    cameras = np.zeros((len(points), 2, 4))
    for _ in range(iterations):
        shape = _whiten(shape, subspace)
        homogeneous = np.concatenate([shape, np.ones((len(shape), 1))], axis=1)
        normal = np.einsum("mk,ki,kj->mij", measured, homogeneous, homogeneous, optimize=True)
        cameras = np.linalg.solve(normal + damping * np.eye(4), np.einsum("ki,mkc->mic", homogeneous, points))
        cameras = cameras.transpose(0, 2, 1)
        shape = _best_shape(points, measured, cameras, subspace, damping)
        residual = points - np.einsum("mci,ki->mkc", cameras[:, :, :3], shape) - cameras[:, None, :, 3]
        previous, error = error, float((np.square(residual).sum(axis=2) * measured).sum() / measured.sum())
        if previous - error < 1e-6 * error:
            break
    return shape, cameras[:, :, :3], error


def _whiten(shape: Array, subspace: SymmetricSubspace) -> Array:
    """An equivalent affine shape with mean zero and unit covariance where the subspace lets it."""
    centred = subspace.project(shape - shape.mean(axis=0))
    covariance = centred.T @ centred / len(centred)
    values, vectors = np.linalg.eigh(covariance)
    inverse_root = (vectors / np.sqrt(np.maximum(values, 1e-6 * values[-1]))) @ vectors.T
    return subspace.project(centred @ inverse_root)


def _best_shape(points: Array, measured: Array, cameras: Array, subspace: SymmetricSubspace, damping: float) -> Array:
    """(K, 3) least-squares shape for affine cameras (M, 2, 4)."""
    linear = cameras[:, :, :3]
    gram = (linear.transpose(0, 2, 1) @ linear).reshape(-1, 9)
    target = (points - cameras[:, None, :, 3]) @ linear * measured[:, :, None]
    shape = np.zeros((points.shape[1], 3))
    lhs, rhs = (measured.T @ gram).reshape(-1, 3, 3), target.sum(axis=0)
    for orbit in subspace.orbits:
        F, k = orbit.maps, orbit.keypoints
        matrix = np.einsum("pic,pij,pjd->cd", F, lhs[k], F) + damping * np.eye(orbit.size)
        shape[k] = F @ np.linalg.solve(matrix, np.einsum("pic,pi->c", F, rhs[k]))
    return shape


def metric_upgrade(shape: Array, cameras: Array, subspace: SymmetricSubspace) -> tuple[Array, Array] | None:
    """Undo the affine ambiguity: cameras A (M, 2, 3) become A B with rows as orthogonal and equally long as can be.

    With Q = B B' symmetric, a1' Q a2 = 0 and a1' Q a1 = a2' Q a2 are linear in Q. Where symmetry is imposed, Q must
    keep the medial plane z = 0, so that Q_xz = Q_yz = 0.

    Returns:
        The Euclidean shape (K, 3) and orthonormal camera rows (M, 2, 3), or None where no positive definite Q fits.
    """
    entries = [(0, 0), (1, 1), (2, 2), (0, 1)] + ([(0, 2), (1, 2)] if subspace.mirror is None else [])
    size = np.sqrt(np.square(cameras).sum(axis=(1, 2)))
    a1, a2 = (cameras[:, row] / size[:, None] for row in (0, 1))

    def coefficients(u: Array, v: Array) -> Array:
        return np.stack([u[:, i] * v[:, j] + (u[:, j] * v[:, i] if i != j else 0.0) for i, j in entries], axis=1)

    system = np.concatenate([coefficients(a1, a2), 0.5 * (coefficients(a1, a1) - coefficients(a2, a2))])
    weight = np.ones(len(system))
    solution = np.zeros(len(entries))
    for _ in range(10):  # reweighted: a few hopeless cameras must not tilt the rest
        solution = np.linalg.svd(system * weight[:, None], full_matrices=False)[2][-1]
        residual = np.abs(system @ solution)
        weight = 1.0 / np.sqrt(np.maximum(residual, 1e-3 * residual.max() + 1e-12))
    Q = np.zeros((3, 3))
    for (i, j), value in zip(entries, solution, strict=True):
        Q[i, j] = Q[j, i] = value
    values, vectors = np.linalg.eigh(Q * np.sign(np.trace(Q)))
    if values[0] <= 1e-6 * values[-1]:
        return None
    root = (vectors * np.sqrt(values)) @ vectors.T
    upgraded = cameras @ root
    u, _, vt = np.linalg.svd(upgraded, full_matrices=False)
    return subspace.project(shape @ np.linalg.inv(root)), u @ vt
