"""The terms about a vehicle's shape alone in one compiled factor: symmetry, rectangularity, dimensions.

The same rows as `symmetry_factor`, `rectangularity_factor` and `dimensions_factor` give, at the price of one callback.
There is no numpy version of the stack: without the compiled kernel those factors are in the graph themselves.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from types import ModuleType

import gtsam
import numpy as np

from factors.guard import CompiledRows, Evaluation, guarded_factor
from factors.keys import M
from factors.rectangularity import rectangles
from factors.shape_factor import ShapeContext
from factors.system import packed_plane

STACKED = ("symmetry", "rectangularity", "dimensions")
"""Terms that the kernel has."""

_MEDIAL = np.array([0.0, 0.0, 1.0, *np.zeros(7)])


class ShapeTerms:
    """The callback of a factor on lambda, the offsets and the medial plane, as far as they are variables.

    Rows are whitened; they belong to the terms that `slices` names.

    Attributes:
        slices: Rows of each term that there is.
    """

    def __init__(self, kernel: ModuleType, about: ShapeContext, names: Collection[str]) -> None:
        """Bind the terms.

        Args:
            kernel: The compiled module (`factors.native.native`).
            about: The vehicle.
            names: Terms of `STACKED` that it has.
        """
        shape, settings, count = about.shape, about.settings, about.shape.size
        pairs, middle = (about.pairs, about.middle) if "symmetry" in names else ((), ())
        quads = rectangles(about) if "rectangularity" in names else ()
        plane_key = M(about.number) if "symmetry" in names else None
        matrix, (size, sigma) = np.zeros((0, 3 * count)), (np.zeros(0), np.zeros(0))
        if "dimensions" in names and about.size is not None:
            matrix, (size, sigma) = np.ascontiguousarray(about.dimension_operator).reshape(3, -1), about.size
        self._compiled = kernel.Shape(
            np.ascontiguousarray(shape.mean),
            np.ascontiguousarray(shape.basis).reshape(len(shape.basis), 3 * count),
            np.array(pairs, dtype=np.intc).reshape(-1, 2),
            np.array(middle, dtype=np.intc),
            settings.symmetry_sigma,
            np.array(quads, dtype=np.intc).reshape(-1, 4),
            settings.rectangularity_sigma,
            matrix,
            np.array(size, dtype=np.float64),
            np.array(sigma, dtype=np.float64),
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
        variable = np.zeros(self._width, dtype=bool)
        variable[: len(shape.basis)] = shape.coefficients_key is not None
        variable[len(shape.basis) : -3] = shape.offsets_key is not None
        variable[-3:] = plane_key is not None
        self._columns = None if variable.all() else np.flatnonzero(variable)

    def factor(self) -> gtsam.CustomFactor:
        """The factor."""
        shape, plane = self._shape, _MEDIAL if self._plane_key is None else self._plane_key
        compiled = CompiledRows(self._compiled, (*shape.bound, plane))
        return guarded_factor("shape terms", 1.0, self._keys, self._dims, self._rows, self, compiled=compiled)

    def energies(self, values: gtsam.Values) -> Iterator[tuple[str, float]]:
        """Name and energy of each term at the values, nats."""
        residual, _ = self(values, want_jacobian=False)
        for name, rows in self.slices.items():
            yield name, 0.5 * float(residual[rows] @ residual[rows])

    def __call__(self, values: gtsam.Values, want_jacobian: bool) -> Evaluation:
        """The rows at the values."""
        plane = _MEDIAL if self._plane_key is None else packed_plane(values.atOrientedPlane3(self._plane_key))
        residual = np.empty(self._rows)
        jacobian = np.empty((self._rows, self._width)) if want_jacobian else None
        variables = (self._shape.coefficients(values), self._shape.offsets(values), plane)
        self._compiled.evaluate(variables, residual, jacobian)
        if jacobian is not None and self._columns is not None:
            jacobian = jacobian[:, self._columns]
        return residual, jacobian
