"""Factors linearised together: what is compiled in one call, the others by GTSAM.

GTSAM solves: it gets a linear graph. A factor that has compiled rows (`factors.guard.CompiledRows`) is in it as part
of a `HessianFactor`, which has all of them that are about the same variables, three at most, or in a small graph
simply all; its noise model whitens and weighs them as GTSAM would. Any other factor, such as one of the caller's own,
is linearised by GTSAM, which calls it back through `factors.guard` where it is Python's. A new kind of rows takes part
by handing `guarded_factor` its `Source` (`factors/_rows.pyx`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from itertools import accumulate, pairwise
from typing import Any

import gtsam
import numpy as np
from numpy.typing import NDArray

from factors.guard import CompiledRows
from factors.native import native

Array = NDArray[np.float64]

_FIRST, _SECOND = 1, 2
_MOST_KEYS = 3
"""Variables of a linear factor that GTSAM's Python package makes."""
_DENSE = 128
"""Numbers of a step up to which one dense factor is solved faster than many sparse ones: a window of five frames."""


class System:
    """Factors of one graph, or of two about the same variables, linearised at one set of values after the other.

    A step is a vector of local coordinates, of one variable after the other in the order of the keys.

    Attributes:
        places: Where a step has each variable, by key.
        size: Numbers of a step.
    """

    def __init__(self, factors: Iterable[Any], values: gtsam.Values, others: Iterable[Any] | None = None) -> None:
        """Bind factors, which may be their compiled rows alone.

        Args:
            factors: The factors, as the solver gets them.
            others: Those of another graph of the same variables, some of them the same; None for one graph alone.
        """
        kernel, zero = native("factors._rows"), values.zeroVectors()
        self.places: dict[int, slice] = {}
        self.size = 0
        for key in values.keys():  # noqa: SIM118  # a key vector
            self.places[key] = slice(self.size, self.size + len(zero.at(key)))
            self.size = self.places[key].stop
        every: dict[int, tuple[Any, int]] = {}
        for graph, some in ((_FIRST, factors), (_SECOND, [] if others is None else others)):
            for factor in some:
                every[id(factor)] = factor, graph | every.get(id(factor), (None, 0))[1]
        self._held = [*every.values()]  # in GTSAM's keeping factors lose what is Python's
        self._rest = {_FIRST: gtsam.NonlinearFactorGraph(), _SECOND: gtsam.NonlinearFactorGraph()}
        self._dense = self.size <= _DENSE
        parts: list[tuple[CompiledRows, int]] = []
        for factor, graphs in self._held:
            rows = factor if isinstance(factor, CompiledRows) else getattr(factor, "compiled", None)
            if kernel is not None and rows is not None and (self._dense or len(rows.keys) <= _MOST_KEYS):
                parts.append((rows, graphs))
                continue
            for graph, rest in self._rest.items():
                if graph & graphs:
                    rest.add(factor)
        self._readers: list[tuple[Callable[[gtsam.Values, int], Array], int]] = []
        self._blocks: list[tuple[tuple[Any, ...], Array]] = []
        self._values: gtsam.Values | None = None
        self._ordering: gtsam.Ordering | None = None
        self._rows: Any = self._bound(kernel, parts) if parts else None

    def _bound(self, kernel: Any, parts: Sequence[tuple[CompiledRows, int]]) -> Any:
        """The compiled rows with their variables."""
        groups, homes = self._groups([rows.keys for rows, _ in parts])
        index: dict[int, int] = {}
        variables: list[tuple[int, int]] = []
        places: list[tuple[Any, ...]] = []
        for (rows, graphs), home in zip(parts, homes, strict=True):
            bound: list[int | Array | None] = []
            for variable, (size, dim, _) in zip(rows.variables, rows.source.takes, strict=True):
                if isinstance(variable, int):
                    if variable not in index:
                        index[variable] = len(variables)
                        variables.append((size, dim))
                        self._readers.append((_READERS.get((size, dim), _vector), variable))
                    bound.append(index[variable])
                else:
                    bound.append(variable)
            places.append((rows.source, graphs, home, bound, rows.whitener, rows.robust))
        if self._dense:
            return kernel.Rows(variables, [(self.size, {i: self.places[k].start for k, i in index.items()})], places)
        ends = [[0, *accumulate(variables[index[key]][1] for key in group)] for group in groups]
        columns = [
            (end[-1], {index[key]: start for key, start in zip(group, end, strict=False)})
            for group, end in zip(groups, ends, strict=True)
        ]
        bound_rows = kernel.Rows(variables, columns, places)
        for group, end, information in zip(groups, ends, bound_rows.information, strict=True):
            self._blocks.append(((*group, *_blocks(information, end)), information))
        return bound_rows

    def _groups(self, every: Sequence[tuple[int, ...]]) -> tuple[list[tuple[int, ...]], list[int]]:
        """Variables of each linear factor, three at most, and the one of each of the keys that rows are about."""
        if self._dense:
            return [], [0] * len(every)
        groups: list[tuple[int, ...]] = []
        homes: dict[tuple[int, ...], int] = {}
        for keys in sorted(set(every), key=len, reverse=True):
            home = next((i for i, group in enumerate(groups) if set(keys) <= set(group)), len(groups))
            if home == len(groups):
                groups.append(keys)
            homes[keys] = home
        return groups, [homes[keys] for keys in every]

    def _load(self, values: gtsam.Values) -> None:
        if values is not self._values:
            self._rows.load([read(values, key) for read, key in self._readers])
            self._values = values

    def linearise(self, values: gtsam.Values, *, second: bool = False) -> tuple[gtsam.GaussianFactorGraph, float]:
        """The linear graph at values, or the other one; and the energy of its compiled factors there, nats.

        That of few variables is one dense factor, of a variable 0 that has all of them: a step.
        """
        graph = _SECOND if second else _FIRST
        rest = self._rest[graph]
        if self._rows is None:
            return rest.linearize(values), 0.0
        self._load(values)
        energy = self._rows.linearise(graph)
        linear = rest.linearize(values) if rest.size() else gtsam.GaussianFactorGraph()
        if self._dense:
            information = self._rows.information[0]
            if rest.size():
                keys = linear.keyVector()
                matrix, vector = linear.hessian(_ordering(keys))
                rows = np.concatenate([np.arange(self.size)[self.places[key]] for key in keys])
                information[rows[:, None], rows] += matrix
                information[rows, -1] += vector
                linear = gtsam.GaussianFactorGraph()
            linear.push_back(gtsam.HessianFactor(0, information[:-1, :-1], information[:-1, -1], information[-1, -1]))
        for blocks, information in self._blocks:
            linear.push_back(_hessian_factor(*blocks, information[-1, -1]))
        return linear, energy

    @property
    def is_one(self) -> bool:
        """Whether the linear graph is one dense factor."""
        return self._dense and self._rows is not None

    def step(self, values: gtsam.Values) -> tuple[Array, float]:
        """The step (D,) to the minimum of the linear graph, and the energy of the compiled factors at the values, nats.

        Raises:
            RuntimeError: GTSAM's only sign of a direction that nothing determines.
        """
        linear, energy = self.linearise(values)
        if self._ordering is None:  # of elimination, the same for every step
            self._ordering = _ordering([0]) if self.is_one else gtsam.Ordering.ColamdGaussianFactorGraph(linear)
        solution = linear.optimize(self._ordering)
        return solution.vector(), energy

    def moved(self, values: gtsam.Values, step: Array) -> gtsam.Values:
        """Where a step leads."""
        by_key = gtsam.VectorValues()
        for key, place in self.places.items():
            by_key.insert(key, step[place])
        return values.retract(by_key)

    def information(self, values: gtsam.Values, *, second: bool = False) -> Array:
        """(D, D) of the linear graph at values, or of the other one, in the order of a step."""
        linear, _ = self.linearise(values, second=second)
        if self.is_one:
            dense: Array = self._rows.information[0][:-1, :-1]
            return dense
        return linear.hessian(_ordering(self.places))[0]

    def error(self, values: gtsam.Values) -> float:
        """Energy of all factors of the first graph at values, nats."""
        energy = self.rest_error(values)
        if self._rows is not None:
            self._load(values)
            energy += self._rows.error(_FIRST)
        return energy

    def rest_error(self, values: gtsam.Values) -> float:
        """Energy of those that are not compiled, nats."""
        rest = self._rest[_FIRST]
        return float(rest.error(values)) if rest.size() else 0.0

    def judge(self, values: gtsam.Values, looks: Sequence[bool]) -> list[Array]:
        """What factors that judge (`Source.judge`) find out of values, in their order; with a look all of it anew."""
        self._load(values)
        found: list[Array] = self._rows.judge(looks)
        return found


def _hessian_factor(*parts: Any) -> gtsam.HessianFactor:
    return gtsam.HessianFactor(*parts)


def _vector(values: gtsam.Values, key: int) -> Array:
    return values.atVector(key)


def _pose(values: gtsam.Values, key: int) -> Array:
    return values.atPose3(key).matrix()


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


def _ordering(keys: Iterable[int]) -> gtsam.Ordering:
    ordering = gtsam.Ordering()
    for key in keys:
        ordering.push_back(key)
    return ordering


def _blocks(information: Array, ends: Sequence[int]) -> list[Array]:
    """Views of a quadratic form in the order in which `HessianFactor` takes them."""
    parts = [slice(a, b) for a, b in pairwise(ends)]
    found: list[Array] = []
    for i, rows in enumerate(parts):
        found += [information[rows, columns] for columns in parts[i:]]
        found.append(information[rows, -1])
    return found
