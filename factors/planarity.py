"""Planar faces, and faces parallel to the ground: E_planar of the paper's section III-C.

    r_v = n_f'X_v(lambda, offsets) + d_f    for the keypoints v of face f, in metres

The normal must have unit length, or n = 0, d = 0 solves everything. Two forms are offered:

* a `gtsam.OrientedPlane3`, of unit normal by construction (preferred);
* a free vector (n, d) with one more residual sqrt(mu) (1 - n'n), whose energy is mu (1 - n'n)^2.

The paper prints the penalty as - mu (1 - n'n), which has its minimum at n = 0, and changes the sign of d between its
planarity and its symmetry energy; here planes are n'X + d = 0 everywhere.
"""

from __future__ import annotations

from dataclasses import dataclass

import gtsam
import numpy as np
from numpy.typing import ArrayLike, NDArray

from factors.checks import index_array, unit_vector
from factors.errors import InvalidInputError
from factors.guard import Evaluation, guarded_factor
from factors.noise import Noise
from factors.planes import tangent_basis
from factors.shape import LinearShape

__all__ = ["ground_parallel_factor", "penalty_ground_parallel_factor", "penalty_planarity_factor", "planarity_factor"]

_UP = (0.0, -1.0, 0.0)


def planarity_factor(shape: LinearShape, face: ArrayLike, plane_key: int, noise: Noise) -> gtsam.CustomFactor:
    """The keypoints of a face lie in a plane of unit normal: one row per keypoint, metres.

    Args:
        shape: The keypoints.
        face: (F,) indices of the face's keypoints, at least three.
        plane_key: Key of an `OrientedPlane3`.
        noise: Noise model of dimension F, or sigma in metres.

    Raises:
        InvalidInputError: The face has fewer than three keypoints or an index out of range.
    """
    indices = index_array("face", face, shape.size, at_least=3)
    callback = _Planarity(shape, indices, _axes_first(shape, indices), plane_key)
    return guarded_factor("planarity", noise, (*shape.keys, plane_key), (*shape.dims, 3), len(indices), callback)


def penalty_planarity_factor(
    shape: LinearShape, face: ArrayLike, plane_key: int, noise: Noise, *, mu: float = 1.0
) -> gtsam.CustomFactor:
    """The same with a free plane vector (n, d) and a penalty on its length: F + 1 rows.

    Args:
        shape: The keypoints.
        face: (F,) indices of the face's keypoints, at least three.
        plane_key: Key of a vector (4,) holding n and d.
        noise: Noise model of dimension F + 1, or sigma in metres.
        mu: Weight of the penalty (1 - n'n)^2 relative to the distances, square metres.

    Raises:
        InvalidInputError: The face has fewer than three keypoints or an index out of range, or mu is not positive.
    """
    if not (np.isfinite(mu) and mu > 0):
        raise InvalidInputError("mu", mu, "Give a positive weight: without it n = 0 solves everything.")
    indices = index_array("face", face, shape.size, at_least=3)
    callback = _PenaltyPlanarity(shape, indices, _axes_first(shape, indices), plane_key, float(np.sqrt(mu)))
    keys, dims = (*shape.keys, plane_key), (*shape.dims, 4)
    return guarded_factor("planarity with penalty", noise, keys, dims, len(indices) + 1, callback)


def ground_parallel_factor(plane_key: int, noise: Noise, up: ArrayLike = _UP) -> gtsam.CustomFactor:
    """A face's normal points along the object's up axis, either way: r = B_up'n, 2 rows.

    B_up is a basis of the plane orthogonal to the axis, so that ||r|| is the sine of the angle between the two.

    Args:
        plane_key: Key of an `OrientedPlane3`.
        noise: Noise model of dimension 2, or sigma in radians.
        up: (3,) up axis in the object frame; scaled to length 1.

    Raises:
        InvalidInputError: The axis has no length.
    """
    callback = _GroundParallel(plane_key, _across(up))
    return guarded_factor("ground-parallel face", noise, (plane_key,), (3,), 2, callback)


def penalty_ground_parallel_factor(plane_key: int, noise: Noise, up: ArrayLike = _UP) -> gtsam.CustomFactor:
    """The same for a free plane vector (n, d), whose length its own penalty keeps near 1: 2 rows.

    Args:
        plane_key: Key of a vector (4,) holding n and d.
        noise: Noise model of dimension 2, or sigma in radians.
        up: (3,) up axis in the object frame; scaled to length 1.

    Raises:
        InvalidInputError: The axis has no length.
    """
    callback = _PenaltyGroundParallel(plane_key, np.hstack([_across(up), np.zeros((2, 1))]))
    return guarded_factor("ground-parallel face", noise, (plane_key,), (4,), 2, callback)


def _axes_first(shape: LinearShape, face: NDArray[np.intp]) -> NDArray[np.float64]:
    """(3, F D) derivative of the face's keypoints, so that one product with a normal covers the whole face."""
    return np.ascontiguousarray(shape.derivative[face].transpose(1, 0, 2)).reshape(3, -1)


def _across(up: ArrayLike) -> NDArray[np.float64]:
    """(2, 3) rows that span the plane orthogonal to the axis."""
    basis: NDArray[np.float64] = gtsam.Unit3(unit_vector("up", up)).basis()
    return np.ascontiguousarray(basis.T)


@dataclass(frozen=True, slots=True)
class _Planarity:
    shape: LinearShape
    face: NDArray[np.intp]
    derivative: NDArray[np.float64]
    plane_key: int

    def __call__(self, values: gtsam.Values, want_jacobian: bool) -> Evaluation:
        points = self.shape.points(values)[self.face]
        plane = values.atOrientedPlane3(self.plane_key)
        coefficients = plane.planeCoefficients()
        normal = coefficients[:3]
        residual = points @ normal + coefficients[3]
        if not want_jacobian:
            return residual, None
        jacobian = np.ones((len(points), self.derivative.shape[1] // len(points) + 3))
        jacobian[:, :-3] = (normal @ self.derivative).reshape(len(points), -1)
        jacobian[:, -3:-1] = points @ tangent_basis(plane)
        return residual, jacobian


@dataclass(frozen=True, slots=True)
class _PenaltyPlanarity:
    shape: LinearShape
    face: NDArray[np.intp]
    derivative: NDArray[np.float64]
    plane_key: int
    root_mu: float

    def __call__(self, values: gtsam.Values, want_jacobian: bool) -> Evaluation:
        points = self.shape.points(values)[self.face]
        plane = values.atVector(self.plane_key)
        normal = plane[:3]
        residual = np.append(points @ normal + plane[3], self.root_mu * (1.0 - normal @ normal))
        if not want_jacobian:
            return residual, None
        count, columns = len(points), self.derivative.shape[1] // len(points)
        jacobian = np.zeros((count + 1, columns + 4))
        jacobian[:count, :columns] = (normal @ self.derivative).reshape(count, columns)
        jacobian[:count, columns:-1] = points
        jacobian[:count, -1] = 1.0
        jacobian[count, columns:-1] = -2.0 * self.root_mu * normal
        return residual, jacobian


@dataclass(frozen=True, slots=True)
class _GroundParallel:
    plane_key: int
    across: NDArray[np.float64]

    def __call__(self, values: gtsam.Values, want_jacobian: bool) -> Evaluation:
        plane = values.atOrientedPlane3(self.plane_key)
        residual = self.across @ plane.planeCoefficients()[:3]
        if not want_jacobian:
            return residual, None
        jacobian = np.zeros((2, 3))
        jacobian[:, :2] = self.across @ tangent_basis(plane)
        return residual, jacobian


@dataclass(frozen=True, slots=True)
class _PenaltyGroundParallel:
    plane_key: int
    operator: NDArray[np.float64]

    def __call__(self, values: gtsam.Values, want_jacobian: bool) -> Evaluation:
        return self.operator @ values.atVector(self.plane_key), self.operator if want_jacobian else None
