"""A sequence that is made when somebody looks at it: records of a solve that most callers never read."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, TypeVar, overload

__all__ = ["Deferred"]

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
