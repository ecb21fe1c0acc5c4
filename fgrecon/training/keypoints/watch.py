"""How long loops let themselves be watched."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any

__all__ = ["Watch", "unwatched"]

Watch = Callable[[Sequence[Any], str], Iterable[Any]]
"""Goes through some things and shows, under a heading, how far it has come."""


def unwatched(things: Sequence[Any], _heading: str) -> Iterable[Any]:
    """Goes through the things and shows nothing."""
    return things
