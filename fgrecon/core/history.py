"""A result's history, made when first read: the steps of the optimisation, the graph's factors, and other minima."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, Self, TypeVar, overload

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.repr import brief_repr
from fgrecon.core.serialise import array, numbers


class LazyFields:
    """Base of frozen dataclasses with such fields. They must have no default of the class (but may have a factory)."""

    @classmethod
    def with_later(cls, later: dict[str, Callable[[], Any]], **known: Any) -> Self:
        """An object whose other fields are made on first use.

        Args:
            later: What makes each of them, by name; it must not change what it is made from.
            known: The fields that are known.
        """
        one = cls(**known, **dict.fromkeys(later))
        for name in later:
            del one.__dict__[name]
        one.__dict__["_later"] = later
        return one

    def __getattr__(self, name: str) -> Any:
        """Make a field: nothing but a field that is not made yet comes here.

        Raises:
            AttributeError: There is none of that name.
        """
        make = self.__dict__.get("_later", {}).get(name)
        if make is None:
            raise AttributeError(f"{type(self).__name__!r} object has no attribute {name!r}", name=name, obj=self)
        return self.__dict__.setdefault(name, make())

    @property
    def not_made(self) -> dict[str, Callable[[], Any]]:
        """What makes the fields that are not made yet, by name."""
        return {name: make for name, make in self.__dict__.get("_later", {}).items() if name not in self.__dict__}

    def maker(self, name: str) -> Callable[[], Any]:
        """What makes a field, or hands it out where it is made."""
        later = self.not_made.get(name)
        return partial(_given, getattr(self, name)) if later is None else later

    def but_later(self, **later: Callable[[], Any]) -> Self:
        """The same with some fields that are made on first use, in the place of its own."""
        one = object.__new__(type(self))
        one.__dict__.update(self.__dict__)
        for name in later:
            one.__dict__.pop(name, None)
        one.__dict__["_later"] = {**self.__dict__.get("_later", {}), **later}
        return one

    def __getstate__(self) -> dict[str, Any]:
        """All fields: a copy and a pickle need nothing of what they are made from."""
        made = {name: getattr(self, name) for name in self.__dict__.get("_later", ())}
        return {**self.__dict__, **made, "_later": {}}


def _given(value: Any) -> Any:
    return value


T = TypeVar("T")


class Deferred(Sequence[T]):
    """An immutable sequence whose items are made on first use, once; it pickles as the tuple of them."""

    __slots__ = ("_items", "_make")

    def __init__(self, make: Callable[[], Iterable[T]]) -> None:
        """Remember how to make the items."""
        self._make: Callable[[], Iterable[T]] | None = make
        self._items: tuple[T, ...] = ()

    def _all(self) -> tuple[T, ...]:
        make = self._make
        if make is not None:
            self._items = tuple(make())
            self._make = None  # and with it whatever the items were made from
        return self._items

    def __len__(self) -> int:
        """Number of items."""
        return len(self._all())

    @overload
    def __getitem__(self, index: int) -> T: ...

    @overload
    def __getitem__(self, index: slice) -> tuple[T, ...]: ...

    def __getitem__(self, index: int | slice) -> T | tuple[T, ...]:
        """An item, or a tuple of some."""
        return self._all()[index]

    def __iter__(self) -> Iterator[T]:
        """Over the items."""
        return iter(self._all())

    def __eq__(self, other: object) -> bool:
        """As the tuple of the items."""
        return self._all() == (other._all() if isinstance(other, Deferred) else other)

    def __hash__(self) -> int:
        """As the tuple of the items."""
        return hash(self._all())

    def __repr__(self) -> str:
        """As the tuple of the items."""
        return repr(self._all())

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle and copy as the tuple of the items."""
        return tuple, (self._all(),)


@dataclass(frozen=True, eq=False)
class Iteration:
    """State after one step of the optimisation.

    Attributes:
        stage: `initialisation`, `pose`, `shape` or `joint`; `scene` of vehicles that were solved together.
        irls: Index of the weight update within the stage, from 0.
        step: Index of the solver's iteration within that update, from 0.
        camera_T_object: (4, 4) pose, maps object coordinates into the camera frame.
        coefficients: (N,) shape coefficients lambda.
        keypoints: (K, 3) keypoints in the object frame, free offsets included.
        projections: (K, 2) their projections, pixels.
        weights: (K,) weight of each keypoint in [0, 1].
        energies: Energy by term, nats. That of keypoints and box is the robust one, which the weights stand for, so
            that it can be compared between stages; a strategy without an energy of its own shows a substitute.
    """

    stage: str
    irls: int
    step: int
    camera_T_object: NDArray[np.float64]
    coefficients: NDArray[np.float64]
    keypoints: NDArray[np.float64]
    projections: NDArray[np.float64]
    weights: NDArray[np.float64]
    energies: Mapping[str, float]

    __repr__ = brief_repr


@dataclass(frozen=True)
class GraphFactor:
    """One factor of the graph that the result minimises, for drawing.

    Attributes:
        term: Its energy term, such as `reprojection`.
        label: The keypoint, face or motion that it is about; empty where the term has one factor.
        variables: Names of the variables that it ties together, such as `X(v=0,t=0)` and `L(v=0)` (`factors.key_name`).
    """

    term: str
    label: str
    variables: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class Alternative:
    """Another pose that explains the keypoints.

    Attributes:
        camera_T_object: (4, 4) pose.
        coefficients: (N,) shape coefficients that go with it.
        excess: How much more energy it has than the result, nats; NaN where the strategy defines no energy.
        probability: That it is the vehicle's pose; NaN where `Uncertainty.facing_probability` is.
    """

    camera_T_object: NDArray[np.float64]
    coefficients: NDArray[np.float64]
    excess: float
    probability: float = float("nan")

    __repr__ = brief_repr


def read_iteration(data: Mapping[str, Any]) -> Iteration:
    """A step from plain values."""
    arrays = ("camera_T_object", "coefficients", "keypoints", "projections", "weights")
    values: dict[str, Any] = {name: array(data[name]) for name in arrays}
    return Iteration(data["stage"], data["irls"], data["step"], energies=numbers(data["energies"]), **values)


def read_graph_factor(data: Mapping[str, Any]) -> GraphFactor:
    """A factor from plain values."""
    return GraphFactor(data["term"], data["label"], tuple(data["variables"]))


def read_alternative(data: Mapping[str, Any]) -> Alternative:
    """Another pose from plain values."""
    excess, probability = float(data["excess"]), float(data.get("probability", "nan"))  # which earlier files have not
    return Alternative(array(data["camera_T_object"]), array(data["coefficients"]), excess, probability)
