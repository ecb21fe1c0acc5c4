"""Results that a run has stored and a later one takes over: what is damaged is named and made again."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

from fgrecon.core.errors import DamagedFileWarning, InvalidInputError

__all__ = ["MADE_AGAIN", "stored"]

MADE_AGAIN = "It is made again."
"""What an error of a reader says to do about a damaged part."""

T = TypeVar("T")


def stored(path: Path, read: Callable[[Path], T]) -> T | None:
    """What a file holds, or None where there is none; a damaged one is put aside as `_NAME.damaged`.

    Args:
        path: The file.
        read: Reads it.

    Warns:
        DamagedFileWarning: It is damaged; names it.
    """
    if not path.exists():
        return None
    try:
        return read(path)
    except InvalidInputError as error:
        aside = path.with_name(f"_{path.name}.damaged")  # readers of Parquet folders pass over such names
        path.replace(aside)
        message = f"{path} is damaged, and what it held is computed again; it is now {aside.name} ({error.value})."
        warnings.warn(message, DamagedFileWarning, stacklevel=2)
        return None
