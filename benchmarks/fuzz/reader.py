"""What the fuzzer reads."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

__all__ = ["Reader"]


@dataclass(frozen=True)
class Reader:
    """A reader and what it reads.

    Attributes:
        read: Reads a file.
        seeds: Valid files: content by name.
    """

    read: Callable[[Path], Any]
    seeds: Callable[[], Mapping[str, bytes]]
