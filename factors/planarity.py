"""Planar faces, and faces parallel to the ground: E_planar of the paper's section III-C.

    r_v = n_f'X_v(lambda, offsets) + d_f    for the keypoints v of face f, in metres

The normal must have unit length, or n = 0, d = 0 solves everything. Two forms are offered:

* a `gtsam.OrientedPlane3`, of unit normal by construction (preferred);
* a free vector (n, d) with one more residual sqrt(mu) (1 - n'n), whose energy is mu (1 - n'n)^2.

The paper prints the penalty as - mu (1 - n'n), which has its minimum at n = 0, and changes the sign of d between its
planarity and its symmetry energy; here planes are n'X + d = 0 everywhere.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import gtsam
import numpy as np
from numpy.typing import ArrayLike, NDArray

from factors.arrays import Array
from factors.checks import index_array, unit_vector
from factors.errors import InvalidInputError
from factors.guard import Evaluation, guarded_factor
from factors.keys import P
from factors.noise import Noise
from factors.shape import LinearShape
from factors.shape_factor import FaceLike, ShapeContext, ShapeTerm, shape_factor

_UP = (0.0, -1.0, 0.0)


class PlanarityTerm(ShapeTerm):
    """A factor for each face, and one for its direction where it is parallel to the ground."""

    name = "planarity"

    def applies(self, about: ShapeContext) -> bool:
        """Whether a face's planarity or direction says something."""
        return bool(self._faces(about))

    def planes(self, about: ShapeContext) -> Mapping[int, NDArray[np.intp] | None]:
        """One for each face."""
        return {P(about.number, i): np.array(face.keypoints) for i, face in self._faces(about).items()}

    def factors(self, about: ShapeContext) -> list[gtsam.NonlinearFactor]:
        """FaceLike by face."""
        settings, mu = about.settings, about.settings.plane_penalty
        result: list[gtsam.NonlinearFactor] = []
        for i, face in self._faces(about).items():
            key = P(about.number, i)
            result.append(planarity_factor(about.shape, face.keypoints, key, settings.planarity_sigma, mu=mu))
            if face.ground_parallel:
                result.append(ground_parallel_factor(key, settings.parallel_sigma, free=mu is not None))
        return result

    def _faces(self, about: ShapeContext) -> dict[int, FaceLike]:
        """Faces by number: not those of two mirrored pairs, which are planar in every symmetric shape."""
        return {
            i: face
            for i, face in enumerate(about.faces)
            if not about.always_symmetric or face.ground_parallel or not _is_mirrored(face, about.mirror)
        }


def _is_mirrored(face: FaceLike, mirror: NDArray[np.intp]) -> bool:
    return len(face.keypoints) == 4 and {int(mirror[i]) for i in face.keypoints} == set(face.keypoints)


def planarity_factor(
    shape: LinearShape, face: ArrayLike, plane_key: int, noise: Noise, *, mu: float | None = None
) -> gtsam.CustomFactor:
    """The keypoints of a face lie in a plane of unit normal: one row per keypoint, metres.

    Args:
        shape: The keypoints.
        face: (F,) indices of the face's keypoints, at least three.
        plane_key: Key of an `OrientedPlane3`; with a penalty that of a vector (4,) holding n and d.
        noise: Noise model of dimension F, with a penalty F + 1, or sigma in metres.
        mu: Weight of the penalty (1 - n'n)^2 relative to the distances, square metres, which adds a row; None for unit
            normals by construction.

    Raises:
        InvalidInputError: The face has fewer than three keypoints or an index out of range, or mu is not positive.
    """
    if mu is not None and not (np.isfinite(mu) and mu > 0):
        raise InvalidInputError("mu", mu, "Give a positive weight: without it n = 0 solves everything.")
    indices, penalised = index_array("face", face, shape.size, at_least=3), mu is not None
    root, size = float(np.sqrt(mu or 0.0)), len(indices)

    def rows(points: Array, plane: Array, want: bool) -> tuple[Array, Array | None, Array | None]:
        normal = plane[:3]
        residual = points[indices] @ normal + plane[3]
        if penalised:
            residual = np.append(residual, root * (1.0 - normal @ normal))
        if not want:
            return residual, None, None
        by_points, by_plane = np.zeros((len(residual), len(points), 3)), np.zeros((len(residual), 4))
        by_points[np.arange(size), indices] = normal
        by_plane[:size, :3], by_plane[:size, 3] = points[indices], 1.0
        by_plane[size:, :3] = -2.0 * root * normal
        return residual, by_points, by_plane

    return shape_factor("planarity", noise, shape, size + penalised, rows, plane_key, free_plane=penalised)


def ground_parallel_factor(
    plane_key: int, noise: Noise, up: ArrayLike = _UP, *, free: bool = False
) -> gtsam.CustomFactor:
    """A face's normal points along the object's up axis, either way: r = B_up'n, 2 rows.

    B_up is a basis of the plane orthogonal to the axis, so that ||r|| is the sine of the angle between the two.

    Args:
        plane_key: Key of an `OrientedPlane3`.
        noise: Noise model of dimension 2, or sigma in radians.
        up: (3,) up axis in the object frame; scaled to length 1.
        free: Whether the plane is a vector (4,) holding n and d, whose length its own penalty keeps near 1.

    Raises:
        InvalidInputError: The axis has no length.
    """
    across = np.ascontiguousarray(gtsam.Unit3(unit_vector("up", up)).basis().T)
    callback = _GroundParallel(plane_key, across, free)
    return guarded_factor("ground-parallel face", noise, (plane_key,), (4 if free else 3,), 2, callback)


@dataclass(frozen=True, slots=True)
class _GroundParallel:
    plane_key: int
    across: Array
    free: bool

    def __call__(self, values: gtsam.Values, want_jacobian: bool) -> Evaluation:
        if self.free:
            normal, basis = values.atVector(self.plane_key)[:3], np.eye(3)
        else:
            plane = values.atOrientedPlane3(self.plane_key)
            normal, basis = plane.planeCoefficients()[:3], plane.normal().basis()
        jacobian = np.hstack([self.across @ basis, np.zeros((2, 1))]) if want_jacobian else None
        return self.across @ normal, jacobian
