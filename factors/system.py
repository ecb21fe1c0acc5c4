"""Factors linearised together: what is compiled in one call, the others by GTSAM.

GTSAM solves: it gets a linear graph. A factor that has compiled rows (`factors.guard.CompiledRows`) is in it as part
of a `HessianFactor`, which has all of them that are about the same variables, three at most; its noise model whitens
and weighs them as GTSAM would. Any other factor, such as one of the caller's own, is linearised by GTSAM, which calls
it back through `factors.guard` where it is Python's. A new kind of rows takes part by handing `guarded_factor` its
`Source` (`factors/_rows.pyx`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from itertools import pairwise
from typing import Any

import gtsam
import numpy as np
from numpy.typing import NDArray

from factors.guard import CompiledRows
from factors.native import native

Array = NDArray[np.float64]

_MOST_KEYS = 3
"""Variables of a linear factor that GTSAM's Python package makes."""


class System:
    """Factors, to be linearised at one set of values after the other."""

    def __init__(self, factors: Iterable[gtsam.NonlinearFactor]) -> None:
        """Sort the factors into those that are compiled and the others."""
        kernel = native("factors._rows")
        self._others = gtsam.NonlinearFactorGraph()
        self._compiled: list[gtsam.NonlinearFactor] = []  # held: in GTSAM's keeping they lose what is Python's
        parts: list[tuple[CompiledRows, tuple[int, ...], gtsam.noiseModel.Base]] = []
        factor: Any  # with or without compiled rows
        for factor in factors:
            compiled: CompiledRows | None = getattr(factor, "compiled", None)
            if kernel is None or compiled is None or factor.size() > _MOST_KEYS:
                self._others.add(factor)
                continue
            self._compiled.append(factor)
            parts.append((compiled, tuple(factor.keys()), factor.noiseModel()))
        self._readers: list[tuple[Callable[[gtsam.Values, int], Array], int]] = []
        self._blocks: list[tuple[tuple[Any, ...], Array]] = []
        self._values: gtsam.Values | None = None
        self._rows: Any = self._bound(kernel, parts) if parts else None

    def _bound(self, kernel: Any, parts: Sequence[tuple[CompiledRows, tuple[int, ...], gtsam.noiseModel.Base]]) -> Any:
        """The compiled rows with their variables, in linear factors of at most three."""
        groups: list[tuple[int, ...]] = []
        for keys in sorted({keys for _, keys, _ in parts}, key=len, reverse=True):
            if not any(set(keys) <= set(group) for group in groups):
                groups.append(keys)
        index: dict[int, int] = {}
        variables: list[tuple[int, int]] = []
        places: list[tuple[Any, ...]] = []
        for compiled, keys, noise in parts:
            bound: list[int | Array | None] = []
            for variable, (size, dim, _) in zip(compiled.variables, compiled.source.takes, strict=True):
                if isinstance(variable, int) and variable not in index:
                    index[variable] = len(variables)
                    variables.append((size, dim))
                    self._readers.append((_READERS.get((size, dim), _vector), variable))
                bound.append(index[variable] if isinstance(variable, int) else variable)
            home = next(i for i, group in enumerate(groups) if set(keys) <= set(group))
            places.append((compiled.source, home, bound, *_noise(noise)))
        rows = kernel.Rows(variables, [[index[key] for key in group] for group in groups], places)
        for group, information in zip(groups, rows.information, strict=True):
            dims = [variables[index[key]][1] for key in group]
            self._blocks.append(((*group, *_blocks(information, dims)), information))
        return rows

    def _load(self, values: gtsam.Values) -> None:
        if values is not self._values:
            self._rows.load([read(values, key) for read, key in self._readers])
            self._values = values

    def linearise(self, values: gtsam.Values) -> tuple[gtsam.GaussianFactorGraph, float]:
        """The linear graph at values, and the energy of the compiled factors there, nats."""
        linear = self._others.linearize(values) if self._others.size() else gtsam.GaussianFactorGraph()
        if self._rows is None:
            return linear, 0.0
        self._load(values)
        energy = self._rows.linearise()
        for blocks, information in self._blocks:
            linear.push_back(_hessian_factor(*blocks, information[-1, -1]))
        return linear, energy

    def error(self, values: gtsam.Values) -> float:
        """Energy of all factors at values, nats."""
        return self.others_error(values) + self.compiled_error(values)

    def others_error(self, values: gtsam.Values) -> float:
        """Energy of the factors that are not compiled, nats."""
        return float(self._others.error(values)) if self._others.size() else 0.0

    def compiled_error(self, values: gtsam.Values) -> float:
        """Energy of the compiled factors, nats."""
        if self._rows is None:
            return 0.0
        self._load(values)
        return float(self._rows.error())

    def judge(self, values: gtsam.Values, looks: Sequence[bool]) -> list[Array]:
        """What factors that judge (`Source.judge`) find out of values, in their order; with a look all of it anew."""
        self._load(values)
        found: list[Array] = self._rows.judge(looks)
        return found


def _hessian_factor(*parts: Any) -> gtsam.HessianFactor:
    factor: gtsam.HessianFactor = gtsam.HessianFactor(*parts)
    return factor


def _vector(values: gtsam.Values, key: int) -> Array:
    vector: Array = values.atVector(key)
    return vector


def _pose(values: gtsam.Values, key: int) -> Array:
    pose: Array = values.atPose3(key).matrix()
    return pose


def _plane(values: gtsam.Values, key: int) -> Array:
    return packed_plane(values.atOrientedPlane3(key))


_READERS = {(12, 6): _pose, (10, 3): _plane}
"""What reads a variable, by its numbers and its dimension; all others are vectors."""


def packed_pose(pose: Array) -> Array:
    """(12,) a pose (4, 4) as sources take it."""
    return np.concatenate([pose[:3, :3].ravel(), pose[:3, 3]])


def packed_plane(plane: gtsam.OrientedPlane3) -> Array:
    """(10,) a plane as sources take it."""
    return np.concatenate([plane.planeCoefficients(), plane.normal().basis().ravel()])


def _noise(model: Any) -> tuple[Array | None, Any]:
    """Whitener and robust estimator of a noise model, None where there is none."""
    robust = None
    if isinstance(model, gtsam.noiseModel.Robust):
        robust, model = model.robust(), model.noise()
    return (None if model.isUnit() else np.ascontiguousarray(model.R())), robust


def _blocks(information: Array, dims: Sequence[int]) -> list[Array]:
    """Views of a quadratic form in the order in which `HessianFactor` takes them."""
    ends = np.cumsum([0, *dims]).tolist()
    parts = [slice(a, b) for a, b in pairwise(ends)]
    found: list[Array] = []
    for i, rows in enumerate(parts):
        found += [information[rows, columns] for columns in parts[i:]]
        found.append(information[rows, -1])
    return found
