"""Frozen data of which some fields are made when they are first read: what takes a while and is seldom looked at."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Self


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

    def __getstate__(self) -> dict[str, Any]:
        """All fields: a copy and a pickle need nothing of what they are made from."""
        made = {name: getattr(self, name) for name in self.__dict__.get("_later", ())}
        return {**self.__dict__, **made, "_later": {}}
