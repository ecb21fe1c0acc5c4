"""Factors linearised and solved together, one set of values after the other.

Where all factors have compiled rows (`factors.guard.CompiledRows`), which is so unless there are some of the caller's
own, `CompiledSystem` linearises them in one call and eliminates by Cholesky (`factors/_rows.pyx`). Else GTSAM does it:
`MixedSystem` gives it a linear graph, where what is compiled is part of a `HessianFactor` for each three variables at
most, and the others are linearised by GTSAM, which calls them back through `factors.guard` where they are Python's. A
new kind of rows takes part by handing `guarded_factor` its `Source`.

A system has points: where it is evaluated. Those of a compiled one are arrays, which cost nothing to move.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from copy import copy
from dataclasses import dataclass
from functools import lru_cache
from itertools import accumulate, pairwise
from typing import Any

import gtsam
import numpy as np
from numpy.typing import NDArray

from factors.arrays import Array
from factors.guard import CompiledRows
from factors.keys import decode_key
from factors.native import native

Point = Any
"""Values of all variables as a system has them: an array, or `gtsam.Values`."""

_MOST_KEYS = 3
"""Variables of a linear factor that GTSAM's Python package makes."""


@dataclass(frozen=True, slots=True)
class _Member:
    """A factor of a system, and its compiled rows if it has them."""

    factor: Any
    rows: CompiledRows | None


def system_of(factors: Iterable[Any], values: gtsam.Values) -> CompiledSystem | MixedSystem:
    """The system of factors, which may be their compiled rows alone.

    Args:
        factors: The factors, as the solver gets them.
        values: All variables.
    """
    compiles = native("factors._rows") is not None
    every = {id(factor): factor for factor in factors}.values()
    members = [_Member(factor, _rows_of(factor) if compiles else None) for factor in every]
    known = {key for member in members if member.rows is not None for key in member.rows.keys}
    if all(member.rows is not None for member in members) and known.issuperset(values.keys()):
        return CompiledSystem(members, values)
    return MixedSystem(members, values)


def _rows_of(factor: Any) -> CompiledRows | None:
    return factor if isinstance(factor, CompiledRows) else getattr(factor, "compiled", None)


class _System:
    """What both have.

    Attributes:
        places: Where a step has each variable, by key: a step is local coordinates of one after the other.
        size: Numbers of a step.
    """

    def __init__(self, values: gtsam.Values) -> None:
        """Lay out the variables, those that many others share last."""
        zero = values.zeroVectors()
        keys = sorted(values.keys(), key=_rank)
        ends = [0, *accumulate([len(zero.at(key)) for key in keys])]
        self.places = {key: slice(a, b) for key, (a, b) in zip(keys, pairwise(ends), strict=True)}
        self.size = ends[-1]


class CompiledSystem(_System):
    """Factors that are all compiled.

    Attributes:
        bound: Their rows with their variables.
        members: The factors, which are held so that no other one has the identity of one of them.
    """

    def __init__(self, members: Sequence[_Member], values: gtsam.Values) -> None:
        """Bind the rows."""
        super().__init__(values)
        self.bound = _Bound(members, self.places)
        self.members = members

    def with_rows(self, rows: CompiledRows) -> CompiledSystem | None:
        """The same with other rows in the place of its first factor; None where they take other variables."""
        first = self.members[0].rows
        assert first is not None
        pairs = zip(first.variables, rows.variables, strict=True)
        if not all(a is b or (isinstance(a, int) and isinstance(b, int) and a == b) for a, b in pairs):
            return None
        other = copy(self)
        other.bound = self.bound.of(self.bound.rows.with_source(rows.source))
        other.members = [_Member(rows, rows), *self.members[1:]]
        return other

    def point(self, values: gtsam.Values) -> Array:
        """The point at values."""
        return self.bound.point(values)

    def values(self, point: Array) -> gtsam.Values:
        """Values at a point."""
        return self.bound.values(point)

    def moved(self, point: Array, step: Array) -> Array:
        """Where a step leads."""
        return self.bound.rows.moved(point, step)

    def step(self, point: Array) -> tuple[Array, Callable[[], float]]:
        """The step (D,) to the minimum of the linear graph at a point, and what tells the energy there, nats.

        Raises:
            RuntimeError: Nothing determines some direction.
        """
        energy = self.bound.rows.linearise(point)
        step: Array | None = self.bound.rows.step()
        if step is None:
            raise RuntimeError("an indeterminate system")
        return step, lambda: float(energy)

    def information(self, point: Array) -> Array:
        """(D, D) of the linear graph at a point, in the order of a step."""
        self.bound.rows.linearise(point)
        return self.bound.rows.information()[:-1, :-1]

    def covariance(
        self, point: Array, least: float, keys: Iterable[int] | None = None
    ) -> Callable[[NDArray[np.intp]], Array] | None:
        """What is left open of variables by the linear graph at a point.

        Args:
            point: Where.
            least: Share of a variable's information that all others must leave.
            keys: Variables that are asked for; None for all.

        Returns:
            A function from indices (m,) of a step to the covariance (m, m); of variables that no factor, or what
            elimination makes of factors, is about together it raises KeyError. None where something is undetermined.
        """
        self.bound.rows.linearise(point)
        begin = min([self.places[key].start for key in (self.places if keys is None else keys)], default=self.size)
        return self.bound.rows.covariance(begin, least)

    def error(self, point: Array) -> float:
        """Energy of all factors at a point, nats."""
        return float(self.bound.rows.error(point))

    def error_of(self, factors: Iterable[Any], point: Point) -> float:
        """Energy of some of its factors at a point, nats."""
        place = {id(member.factor): place for place, member in enumerate(self.members)}
        return float(self.bound.rows.error_of(point, [place[id(factor)] for factor in factors]))

    def judge(self, point: Array, looks: Sequence[bool]) -> list[Array]:
        """What factors that judge (`Source.judge`) find out of a point, in their order; with a look all of it anew."""
        return self.bound.rows.judge(point, looks)


class MixedSystem(_System):
    """Factors of which some are not compiled, or none: linearised and solved by GTSAM. Its points are values."""

    def __init__(self, members: Sequence[_Member], values: gtsam.Values) -> None:
        """Bind factors and rows."""
        super().__init__(values)
        self._rest = gtsam.NonlinearFactorGraph()
        self._held = members  # in GTSAM's keeping factors lose what is Python's
        groups: dict[tuple[int, ...], list[_Member]] = {}
        for member in sorted(members, key=_count, reverse=True):
            if member.rows is None or _count(member) > _MOST_KEYS:
                self._rest.add(member.factor)
            else:
                keys = member.rows.keys
                groups.setdefault(next((g for g in groups if {*keys} <= {*g}), keys), []).append(member)
        self._groups = [_Bound(some, {key: self.places[key] for key in keys}) for keys, some in groups.items()]
        judging = [member for member in members if member.rows is not None and member.rows.source.judged]
        self._judging = _Bound(judging, self.places) if judging else None
        self._ordering: gtsam.Ordering | None = None

    def point(self, values: gtsam.Values) -> gtsam.Values:
        """The point at values."""
        return values

    def values(self, point: gtsam.Values) -> gtsam.Values:
        """Values at a point."""
        return point

    def moved(self, point: gtsam.Values, step: Array) -> gtsam.Values:
        """Where a step leads."""
        by_key = gtsam.VectorValues()
        for key, place in self.places.items():
            by_key.insert(key, step[place])
        return point.retract(by_key)

    def linear(self, point: gtsam.Values) -> tuple[gtsam.GaussianFactorGraph, float]:
        """The linear graph at a point, and the energy of its compiled factors there, nats."""
        linear, energy = self._rest.linearize(point), 0.0
        for bound in self._groups:
            energy += bound.rows.linearise(bound.point(point))
            linear.push_back(bound.hessian_factor())
        return linear, energy

    def step(self, point: gtsam.Values) -> tuple[Array, Callable[[], float]]:
        """The step (D,) to the minimum of the linear graph at a point, and what tells the energy there, nats.

        Raises:
            RuntimeError: GTSAM's only sign of a direction that nothing determines.
        """
        linear, energy = self.linear(point)
        if self._ordering is None:  # of elimination, the same for every step
            self._ordering = gtsam.Ordering.ColamdGaussianFactorGraph(linear)
        step: Array = linear.optimize(self._ordering).vector(gtsam.KeyVector([*self.places]))
        return step, lambda: energy + float(self._rest.error(point))

    def information(self, point: gtsam.Values) -> Array:
        """(D, D) of the linear graph at a point, in the order of a step."""
        return self.linear(point)[0].hessian(ordering_of(self.places))[0]

    def error(self, point: gtsam.Values) -> float:
        """Energy of all factors of the first graph at a point, nats."""
        energies = [bound.rows.error(bound.point(point)) for bound in self._groups]
        return float(self._rest.error(point) + sum(energies))

    def error_of(self, factors: Iterable[Any], point: Point) -> float:
        """Energy of some of its factors at a point, nats."""
        return float(sum(factor.error(point) for factor in factors))

    def judge(self, point: gtsam.Values, looks: Sequence[bool]) -> list[Array]:
        """What factors that judge (`Source.judge`) find out of a point, in their order; with a look all of it anew."""
        if self._judging is None:
            return []
        return self._judging.rows.judge(self._judging.point(point), looks)


class _Bound:
    """Compiled rows with their variables.

    Attributes:
        rows: The rows.
    """

    def __init__(self, members: Sequence[_Member], keys: Iterable[int]) -> None:
        """Bind the rows of members to variables; those that none of them is about are left out."""
        kernel, kinds = native("factors._rows"), {}
        assert kernel is not None
        compiled = [member.rows for member in members if member.rows is not None]
        for rows in compiled:
            for variable, (numbers, dim, _) in zip(rows.variables, rows.source.takes, strict=True):
                if isinstance(variable, int):
                    kinds[variable] = numbers, dim
        self._kinds = {key: kinds[key] for key in keys if key in kinds}
        index = {key: i for i, key in enumerate(self._kinds)}
        places = []
        for rows in compiled:
            bound = [index[variable] if isinstance(variable, int) else variable for variable in rows.variables]
            places.append((rows.source, bound, rows.whitener, rows.robust))
        self._readers = [(_READERS.get(kind, _vector), key) for key, kind in self._kinds.items()]
        self.rows = kernel.Rows([*self._kinds.values()], places)

    def of(self, rows: Any) -> _Bound:
        """The same variables with rows that take the same."""
        other = copy(self)
        other.rows = rows
        return other

    def point(self, values: gtsam.Values) -> Array:
        """The variables as the rows take them."""
        return self.rows.point([read(values, key) for read, key in self._readers])

    def values(self, point: Array) -> gtsam.Values:
        """The variables of a point."""
        values, start = gtsam.Values(), 0
        for key, kind in self._kinds.items():
            numbers = point[start : start + kind[0]]
            start += kind[0]
            values.insert(key, _variable(kind, numbers))
        return values

    def hessian_factor(self) -> gtsam.HessianFactor:
        """What the rows linearised last are, for GTSAM."""
        information = self.rows.information()
        ends = [0, *accumulate([dim for _, dim in self._kinds.values()])]
        parts = [slice(a, b) for a, b in pairwise(ends)]
        blocks: list[Any] = [*self._kinds]
        for i, rows in enumerate(parts):
            blocks += [information[rows, columns] for columns in parts[i:]]
            blocks.append(information[rows, -1])
        return _hessian_factor(*blocks, information[-1, -1])


def _hessian_factor(*parts: Any) -> gtsam.HessianFactor:
    return gtsam.HessianFactor(*parts)


def _count(member: _Member) -> int:
    return 0 if member.rows is None else len(member.rows.keys)


@lru_cache(maxsize=4096)
def _rank(key: int) -> tuple[int | bool, ...]:
    """Where a variable comes in a step: images of a vehicle, its shape, the next vehicle; last what vehicles share."""
    letter, vehicle, low = decode_key(key)
    return letter in "DFGS", vehicle, letter not in "XV", low, key


def _vector(values: gtsam.Values, key: int) -> Array:
    return values.atVector(key)


def _pose(values: gtsam.Values, key: int) -> Array:
    return values.atPose3(key).matrix()


def _plane(values: gtsam.Values, key: int) -> Array:
    return packed_plane(values.atOrientedPlane3(key))


_READERS = {(12, 6): _pose, (10, 3): _plane}
"""What reads a variable, by its numbers and its dimension; all others are vectors."""


def _variable(kind: tuple[int, int], numbers: Array) -> Any:
    """What a reader reads, from its numbers."""
    if kind == (12, 6):
        return gtsam.Pose3(gtsam.Rot3(numbers[:9].reshape(3, 3)), numbers[9:])
    return gtsam.OrientedPlane3(numbers[:4]) if kind == (10, 3) else numbers


def packed_pose(pose: Array) -> Array:
    """(12,) a pose (4, 4) as sources take it."""
    return np.concatenate([pose[:3, :3].ravel(), pose[:3, 3]])


def packed_plane(plane: gtsam.OrientedPlane3) -> Array:
    """(10,) a plane as sources take it."""
    return np.concatenate([plane.planeCoefficients(), plane.normal().basis().ravel()])


def ordering_of(keys: Iterable[int]) -> gtsam.Ordering:
    """The variables in an order of elimination."""
    ordering = gtsam.Ordering()
    for key in keys:
        ordering.push_back(key)
    return ordering
