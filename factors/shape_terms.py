"""The terms about a vehicle's shape alone in one compiled factor: symmetry, rectangularity, dimensions.

The same rows as `symmetry_factor`, `rectangularity_factor` and `dimensions_factor` give, at the price of one callback.
There is no numpy version of the stack: without the compiled kernel those factors are in the graph themselves.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from types import ModuleType

import gtsam
import numpy as np
from numpy.typing import NDArray

from factors.guard import Evaluation, guarded_factor
from factors.planes import tangent_basis
from factors.shape import LinearShape

__all__ = ["ShapeTerms"]

Array = NDArray[np.float64]

_MEDIAL = np.array([0.0, 0.0, 1.0, 0.0])
_NO_TANGENT = np.zeros((3, 2))


class ShapeTerms:
    """The callback of a factor on lambda, the offsets and the medial plane, as far as they are variables.

    Rows are whitened; they belong to the terms that `slices` names.

    Attributes:
        slices: Rows of each term that there is.
    """

    def __init__(
        self,
        kernel: ModuleType,
        shape: LinearShape,
        *,
        pairs: Sequence[tuple[int, int]] = (),
        middle: Sequence[int] | NDArray[np.intp] = (),
        plane_key: int | None = None,
        pair_sigma: float = 1.0,
        quads: Sequence[Sequence[int]] = (),
        quad_sigma: float = 1.0,
        operator: Array | None = None,
        size: Array | None = None,
        size_sigma: Array | None = None,
    ) -> None:
        """Bind the terms.

        Args:
            kernel: The compiled module (`factors.native.native`).
            shape: The keypoints.
            pairs: Pairs (left, right) of mirror images; none leaves symmetry out.
            middle: Keypoints that are their own mirror image.
            plane_key: Key of the medial plane, an `OrientedPlane3`, where there are pairs.
            pair_sigma: Standard deviation of symmetry's rows, metres.
            quads: Rectangles, in order around each.
            quad_sigma: Standard deviation of rectangularity's rows, metres.
            operator: (3, K, 3) linear map from keypoints to length, width and height; None leaves dimensions out.
            size: (3,) their mean, metres.
            size_sigma: (3,) their standard deviation, metres.
        """
        count = shape.size
        matrix = np.zeros((0, 3 * count)) if operator is None else np.ascontiguousarray(operator).reshape(3, -1)
        none = np.zeros(0)
        self._compiled = kernel.Shape(
            np.ascontiguousarray(shape.mean),
            np.ascontiguousarray(shape.basis).reshape(len(shape.basis), 3 * count),
            np.array(pairs, dtype=np.intc).reshape(-1, 2),
            np.array(middle, dtype=np.intc),
            pair_sigma,
            np.array(quads, dtype=np.intc).reshape(-1, 4),
            quad_sigma,
            matrix,
            none if size is None else np.array(size, dtype=np.float64),
            none if size_sigma is None else np.array(size_sigma, dtype=np.float64),
        )
        self._shape, self._plane_key = shape, plane_key
        lengths = {
            "symmetry": 3 * len(pairs) + len(middle),
            "rectangularity": 4 * len(quads),
            "dimensions": len(matrix),
        }
        self.slices: dict[str, slice] = {}
        start = 0
        for name, length in lengths.items():
            if length:
                self.slices[name] = slice(start, start + length)
            start += length
        self._rows = start
        self._keys = (*shape.keys, *(() if plane_key is None else (plane_key,)))
        self._dims = (*shape.dims, *(() if plane_key is None else (3,)))
        self._width = len(shape.basis) + 3 * count + 3
        wanted = np.zeros(self._width, dtype=bool)
        wanted[: len(shape.basis)] = shape.coefficients_key is not None
        wanted[len(shape.basis) : -3] = shape.offsets_key is not None
        wanted[-3:] = plane_key is not None
        self._columns = None if wanted.all() else np.flatnonzero(wanted)

    def factor(self) -> gtsam.CustomFactor:
        """The factor."""
        return guarded_factor("shape terms", 1.0, self._keys, self._dims, self._rows, self)

    def energies(self, values: gtsam.Values) -> Iterator[tuple[str, float]]:
        """Name and energy of each term at the values, nats."""
        residual, _ = self(values, want_jacobian=False)
        for name, rows in self.slices.items():
            yield name, 0.5 * float(residual[rows] @ residual[rows])

    def __call__(self, values: gtsam.Values, want_jacobian: bool) -> Evaluation:
        """The rows at the values."""
        plane, tangent = _MEDIAL, _NO_TANGENT
        if self._plane_key is not None:
            medial = values.atOrientedPlane3(self._plane_key)
            plane = medial.planeCoefficients()
            if want_jacobian:
                tangent = tangent_basis(medial)
        residual = np.empty(self._rows)
        jacobian = np.empty((self._rows, self._width)) if want_jacobian else None
        self._compiled.rows_at(
            self._shape.coefficients(values), self._shape.offsets(values), plane, tangent, residual, jacobian
        )
        if jacobian is not None and self._columns is not None:
            jacobian = jacobian[:, self._columns]
        return residual, jacobian
