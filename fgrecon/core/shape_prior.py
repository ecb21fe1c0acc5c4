"""The shape prior: a linear model of keypoints, and optionally of a surface driven by the same coefficients."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fgrecon.core.category import Category
from fgrecon.core.checks import as_finite, as_instance, as_shape, own
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.geometry import MIRROR
from fgrecon.core.repr import brief_repr
from fgrecon.core.size_prior import LONGEST, SHORTEST, SIZES, SizePrior

_SYMMETRY_TOLERANCE = 1e-6

_FARTHEST = 100.0  # metres from the origin: no part of a vehicle, however it is scaled, lies there
_ROUNDED = 1e-6  # of a size that was scaled to the smallest or the largest
_LARGEST = 1e6  # metres; no vehicle is larger, and squares of numbers soon overflow


@dataclass(frozen=True, eq=False)
class Surface:
    """A triangle mesh whose vertices move linearly with lambda.

    Attributes:
        mean: (V, 3) mean vertices, object frame, metres.
        basis: (N, V, 3) change of the vertices per unit of each coefficient.
        faces: (F, 3) vertex indices of each triangle.
    """

    mean: NDArray[np.float64]
    basis: NDArray[np.float64]
    faces: NDArray[np.int32]

    __repr__ = brief_repr

    def __post_init__(self) -> None:
        """Check every array's shape and values.

        Raises:
            InvalidInputError: An array has the wrong shape, there is no vertex, a number is not finite or no vehicle's,
                or a triangle has a vertex that there is not.
        """
        set_ = object.__setattr__
        vertices = as_finite("prior.surface.mean", self.mean, (None, 3))
        if not len(vertices):
            raise InvalidInputError("prior.surface.mean", "no vertices", "Give vertices, or a prior without a surface.")
        basis = as_finite("prior.surface.basis", self.basis, (None, len(vertices), 3))
        _check_metres("prior.surface.mean", vertices, _FARTHEST)
        _check_metres("prior.surface.basis", basis, _LARGEST)
        faces = np.asarray(self.faces)
        if faces.ndim != 2 or faces.shape[1] != 3 or faces.dtype.kind not in "iu":
            raise InvalidInputError("prior.surface.faces", f"{faces.dtype} {faces.shape}", "Give integers (F, 3).")
        if faces.size and (faces.min() < 0 or faces.max() >= len(vertices)):
            raise InvalidInputError("prior.surface.faces", faces.max(), f"Use indices below {len(vertices)}.")
        set_(self, "mean", own(vertices))
        set_(self, "basis", own(basis))
        set_(self, "faces", own(faces.astype(np.int32, copy=False)))

    @cached_property
    def triangles(self) -> NDArray[np.int64]:
        """(F, 3) `faces` as results have them: one array for all, since there may be thousands of results."""
        return own(self.faces.astype(np.int64))

    def vertices(self, coefficients: ArrayLike) -> NDArray[np.float64]:
        """(V, 3) vertices at the coefficients (N,)."""
        return self.mean + _combined(coefficients, self.basis)


@dataclass(frozen=True, eq=False)
class ShapePrior:
    """Linear shape model X(lambda) = mean + sum_j lambda_j basis_j with lambda ~ N(0, I) (Eq. 1 of the paper).

    Beside lambda a shape may carry a free offset per keypoint, X(lambda) + offset with offset ~ N(0, offset_sigma^2 I),
    so that a wireframe can leave the subspace.

    Attributes:
        category: The category whose keypoint order the arrays follow.
        mean: (K, 3) mean keypoints, object frame, metres.
        basis: (N, K, 3) basis vectors, each scaled by its standard deviation.
        surface: Dense surface driven by the same coefficients, or None.
        offset_sigma: (K,) standard deviation of each keypoint's free offset per axis, metres: what the basis leaves
            unexplained in the data that it was learnt from.
        explained: (N,) fraction of the data's variance that each vector explains.
        name: Name shown beside results.
        provenance: Learnt from what, how, under which terms (plain strings).
        mean_sigma: (K, 3) standard deviation of each mean keypoint by what it was learnt from, metres: how far it would
            move if other vehicles had been annotated. None where that was not estimated. No solve uses it.
    """

    category: Category
    mean: NDArray[np.float64]
    basis: NDArray[np.float64]
    offset_sigma: NDArray[np.float64]
    explained: NDArray[np.float64]
    surface: Surface | None = None
    name: str = "unnamed"
    provenance: Mapping[str, str] = field(default_factory=dict)
    mean_sigma: NDArray[np.float64] | None = None

    __repr__ = brief_repr

    def __post_init__(self) -> None:
        """Check every array's shape and values.

        Raises:
            InvalidInputError: An array has the wrong shape, or holds NaN or infinite values, or the mean shape's size
                is no vehicle's: metres are mistaken for another unit.
        """
        size = as_instance("prior.category", self.category, Category).size
        set_ = object.__setattr__  # the dataclass is frozen; arrays are normalised once, here
        set_(self, "mean", own(as_finite("prior.mean", self.mean, (size, 3))))
        set_(self, "basis", own(as_finite("prior.basis", self.basis, (None, size, 3))))
        count = self.basis.shape[0]
        set_(self, "offset_sigma", own(as_finite("prior.offset_sigma", self.offset_sigma, (size,))))
        set_(self, "explained", own(as_finite("prior.explained", self.explained, (count,))))
        for name in ("mean", "basis", "offset_sigma"):
            _check_metres(f"prior.{name}", getattr(self, name), _LARGEST)
        if (self.offset_sigma < 0).any():
            raise InvalidInputError("prior.offset_sigma", self.offset_sigma.min(), "Give standard deviations >= 0.")
        if self.mean_sigma is not None:
            set_(self, "mean_sigma", own(as_finite("prior.mean_sigma", self.mean_sigma, (size, 3))))
            if (self.mean_sigma < 0).any() or (self.mean_sigma > _LARGEST).any():
                worst = float(self.mean_sigma.flat[np.abs(self.mean_sigma).argmax()])
                raise InvalidInputError("prior.mean_sigma", worst, "Give standard deviations in metres, >= 0.")
        if np.linalg.matrix_rank(self.mean - self.mean.mean(axis=0)) < 2:
            raise InvalidInputError("prior.mean", "keypoints on one line", "Give a shape that is not degenerate.")
        box = self.box_size(np.zeros(count))
        if (box < SHORTEST * (1.0 - _ROUNDED)).any() or (box > LONGEST * (1.0 + _ROUNDED)).any():
            fix = f"Bring the shape into the object frame, x forward, y down, z left, in metres: {SIZES}."
            raise InvalidInputError("prior.mean", f"length, width, height {box.round(3).tolist()}", fix)
        if self.surface is not None:
            as_instance("prior.surface", self.surface, Surface)
            as_shape("prior.surface.basis", self.surface.basis, (count, len(self.surface.mean), 3))
        set_(self, "provenance", dict(as_instance("prior.provenance", self.provenance, Mapping)))

    @property
    def dimension(self) -> int:
        """Number of coefficients N."""
        return len(self.basis)

    def keypoints(self, coefficients: ArrayLike, offsets: ArrayLike | None = None) -> NDArray[np.float64]:
        """(K, 3) keypoints in the object frame at the coefficients (N,) and free offsets (K, 3)."""
        shape = self.mean + _combined(coefficients, self.basis)
        return shape if offsets is None else shape + np.asarray(offsets, dtype=np.float64)

    def box_size(self, coefficients: ArrayLike, offsets: ArrayLike | None = None) -> NDArray[np.float64]:
        """(3,) length, width and height of the vehicle's box in metres, by the category's ratios."""
        return self.category.box_size(self.keypoints(coefficients, offsets))

    @cached_property
    def is_symmetric(self) -> bool:
        """Whether X(lambda) is mirror-symmetric about z = 0 for every lambda."""
        mirror = self.category.mirror
        arrays = (self.mean[None], self.basis)
        scale = max(1.0, float(np.abs(self.mean).max()))
        return all(np.abs(a[:, mirror] * MIRROR - a).max(initial=0.0) <= _SYMMETRY_TOLERANCE * scale for a in arrays)

    def truncated(self, dimension: int) -> ShapePrior:
        """The same prior with the first `dimension` basis vectors alone.

        Raises:
            InvalidInputError: The prior has fewer vectors.
        """
        if not 0 <= dimension <= self.dimension:
            raise InvalidInputError("dimension", dimension, f"Give a number from 0 to {self.dimension}.")
        surface = self.surface
        if surface is not None:
            surface = replace(surface, basis=surface.basis[:dimension])
        return replace(self, basis=self.basis[:dimension], explained=self.explained[:dimension], surface=surface)

    def scaled(self, factors: ArrayLike) -> ShapePrior:
        """Mean, basis and surface scaled by one factor, or by three along x, y and z."""
        s = np.broadcast_to(np.asarray(factors, dtype=np.float64), (3,))
        if not (np.isfinite(s).all() and (s > 0).all()):
            raise InvalidInputError("factors", s.tolist(), "Give positive numbers.")
        surface = self.surface
        if surface is not None:
            surface = Surface(surface.mean * s, surface.basis * s, surface.faces)
        sigma = self.offset_sigma * float(np.cbrt(s.prod()))
        moved = None if self.mean_sigma is None else self.mean_sigma * s
        return replace(
            self, mean=self.mean * s, basis=self.basis * s, offset_sigma=sigma, surface=surface, mean_sigma=moved
        )

    def for_fleet(self, size: SizePrior) -> ShapePrior:
        """The prior scaled per axis so that its mean has the mean size of a fleet (names both in `name`)."""
        length, width, height = size.mean / self.box_size(np.zeros(self.dimension))
        return replace(self.scaled((length, height, width)), name=f"{self.name} scaled to {size.name}")

    def describe(self) -> dict[str, Any]:
        """Name, sizes and provenance, for reports."""
        return {
            "name": self.name,
            "category": self.category.name,
            "basis_vectors": self.dimension,
            "symmetric": self.is_symmetric,
            "surface_vertices": 0 if self.surface is None else len(self.surface.mean),
            **dict(self.provenance),
        }


def _check_metres(field: str, array: NDArray[np.float64], most: float) -> None:
    largest = float(np.abs(array).max(initial=0.0))
    if largest > most:
        raise InvalidInputError(field, largest, f"Give metres, up to {most:g}.")


def _combined(coefficients: ArrayLike, basis: NDArray[np.float64]) -> NDArray[np.float64]:
    """(P, 3) sum of basis vectors (N, P, 3) times coefficients (N,), as np.tensordot has it at twice the time."""
    count, points, _ = basis.shape
    row = np.asarray(coefficients, dtype=np.float64)[None]
    total: NDArray[np.float64] = row.dot(basis.reshape(count, 3 * points))
    return total.reshape(points, 3)
