"""How loops show how far they have come."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any

Progress = Callable[[Sequence[Any], str], Iterable[Any]]
"""Goes through the items of a loop and shows, under a description, how many are done."""


def no_progress(items: Sequence[Any], _description: str) -> Iterable[Any]:
    """Goes through the items and shows nothing."""
    return items
