"""Shape terms: their parts, their factors, and the one place where they are registered.

A term is one object: its name, whether it says something about a vehicle, its variables beside the shape's, and its
factors. Its rows are a function of the keypoints X (K, 3) and of a plane (n, d), written once; `shape_factor` chains
their derivatives to the variables. To add one write a module with a subclass of `ShapeTerm` and name it in
`SHAPE_TERMS`: it can then be switched off by its name (`fgrecon.Options`), and the graph has it.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from typing import TYPE_CHECKING, Any, ClassVar, Protocol

import numpy as np
from numpy.typing import NDArray

from factors.arrays import Array

if TYPE_CHECKING:  # on use: names need nothing
    import gtsam

    from factors.guard import Evaluation
    from factors.noise import Noise
    from factors.shape import LinearShape


SHAPE_TERMS = {
    "coefficients": "factors.shape_prior:CoefficientsTerm",
    "offsets": "factors.shape_prior:OffsetsTerm",
    "planarity": "factors.planarity:PlanarityTerm",
    "symmetry": "factors.symmetry:SymmetryTerm",
    "rectangularity": "factors.rectangularity:RectangularityTerm",
    "dimensions": "factors.dimensions:DimensionsTerm",
    "laplacian": "factors.laplacian:LaplacianTerm",
}
"""Every term about a vehicle's shape, by name: module and class."""

PointRows = Callable[[Array, Array, bool], tuple[Array, Array | None, Array | None]]
"""Rows at keypoints (K, 3) and a plane (4,): residual (R,) and, where wanted, its derivatives by the keypoints
(R, K, 3) and by the plane (R, 4); the latter None without a plane."""


class FaceLike(Protocol):
    """A face of a vehicle's category."""

    @property
    def keypoints(self) -> tuple[int, ...]:
        """Its keypoints, in order around it."""

    @property
    def rectangular(self) -> bool:
        """Whether they form a rectangle."""

    @property
    def ground_parallel(self) -> bool:
        """Whether it is parallel to the ground."""


@dataclass(frozen=True)
class ShapeContext:
    """A vehicle whose shape is free, as terms see it.

    Attributes:
        shape: The keypoints as a function of lambda and the offsets.
        number: Number of the vehicle in the keys.
        faces: Faces of its category.
        pairs: Pairs (left, right) of keypoints that mirror each other.
        mirror: (K,) the mirror image of each keypoint; itself in the middle.
        neighbours: Of each keypoint.
        mirrored_prior: Whether every shape of the prior is symmetric.
        dimension_operator: (3, K, 3) linear map from keypoints to length, width and height.
        size: Mean (3,) and standard deviation (3,) of length, width and height, metres, where a fleet is known.
        offset_sigma: (K,) or (K, 3) standard deviation of the offsets, metres.
        spread: (N, N) covariance of lambda; None for that of the prior, I.
        by_size: (N, 3) change of lambda with the mean size of a fleet S that is a variable; None where it is none.
        settings: Sigmas and choices by name, as `fgrecon.core.options.ShapeOptions` has them.
        disabled: Names of terms that are off.
    """

    shape: LinearShape
    number: int
    faces: Sequence[FaceLike]
    pairs: Sequence[tuple[int, int]]
    mirror: NDArray[np.intp]
    neighbours: Sequence[Sequence[int]]
    mirrored_prior: bool
    dimension_operator: Array
    size: tuple[Array, Array] | None
    offset_sigma: Array
    spread: Array | None
    by_size: Array | None
    settings: Any
    disabled: Collection[str]

    @property
    def always_symmetric(self) -> bool:
        """Whether the shape is symmetric for every value of its variables."""
        return self.mirrored_prior and self.shape.offsets_key is None

    @property
    def middle(self) -> NDArray[np.intp]:
        """Keypoints that are their own mirror image."""
        return np.flatnonzero(self.mirror == np.arange(len(self.mirror)))


class ShapeTerm:
    """A term about a vehicle's shape."""

    name: ClassVar[str]

    def applies(self, about: ShapeContext) -> bool:  # noqa: ARG002
        """Whether it says something about the vehicle; always, where a term does not say."""
        return True

    def planes(self, about: ShapeContext) -> Mapping[int, NDArray[np.intp] | None]:  # noqa: ARG002
        """Keys of its planes, with the keypoints that each is fitted to at the start; None: the medial plane."""
        return {}

    def factors(self, about: ShapeContext) -> list[gtsam.NonlinearFactor]:
        """Its factors, where it applies."""
        raise NotImplementedError


@cache
def shape_terms() -> tuple[ShapeTerm, ...]:
    """All registered terms."""
    homes = (home.split(":") for home in SHAPE_TERMS.values())
    return tuple(getattr(import_module(module), kind)() for module, kind in homes)


def shape_factor(
    name: str,
    noise: Noise,
    shape: LinearShape,
    count: int,
    rows: PointRows,
    plane_key: int | None = None,
    *,
    free_plane: bool = False,
) -> gtsam.CustomFactor:
    """The factor of rows on the shape's variables and a plane.

    Args:
        name: For error messages.
        noise: Noise model of `count` rows, or one sigma.
        shape: The keypoints.
        count: Number of rows.
        rows: What has them.
        plane_key: Key of a plane, an `OrientedPlane3`.
        free_plane: Whether the plane is a vector (4,) of n and d instead.

    Raises:
        InvalidInputError: The shape is a constant, or the noise model has another dimension.
    """
    from factors.guard import guarded_factor

    keys, dims = (shape.keys, shape.dims)
    if plane_key is not None:
        keys, dims = (*keys, plane_key), (*dims, 4 if free_plane else 3)
    return guarded_factor(name, noise, keys, dims, count, _Callback(shape, rows, plane_key, free_plane))


_NO_PLANE = np.zeros(4)


@dataclass(frozen=True, slots=True)
class _Callback:
    shape: LinearShape
    rows: PointRows
    plane_key: int | None
    free_plane: bool

    def __call__(self, values: gtsam.Values, want_jacobian: bool) -> Evaluation:
        plane, points = _NO_PLANE, self.shape.points(values)
        if self.plane_key is not None:
            oriented = None if self.free_plane else values.atOrientedPlane3(self.plane_key)
            plane = values.atVector(self.plane_key) if oriented is None else oriented.planeCoefficients()
        residual, by_points, by_plane = self.rows(points, plane, want_jacobian)
        if by_points is None:
            return residual, None
        jacobian = self.shape.chain(by_points.reshape(len(residual), -1))
        if by_plane is None or self.plane_key is None:
            return residual, jacobian
        if oriented is not None:  # the local coordinates are two along the normal's tangent basis, and d
            by_plane = np.column_stack([by_plane[:, :3] @ oriented.normal().basis(), by_plane[:, 3]])
        return residual, np.concatenate([jacobian, by_plane], axis=1)
