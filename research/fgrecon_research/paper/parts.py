"""The parts that `fgrecon evaluate paper` stores, told from whatever else lies in their folder."""

from __future__ import annotations

import re
import zipfile
from collections.abc import Iterator
from dataclasses import fields
from pathlib import Path

from fgrecon_research.paper.simulated_run import CONDITIONS
from fgrecon_research.paper.simulated_scores import Scores

KNOWN_SHAPE = "known_shape"
"""Folder of the cars of known shape."""

_NAME = re.compile(r".+-[0-9a-f]{12}\.npz")  # what it is about, and a digest of what it was made from
_ARRAYS = {
    **{condition.name: frozenset(field.name for field in fields(Scores)) for condition in CONDITIONS},
    KNOWN_SHAPE: frozenset(["table", "failures"]),
}


def stored_parts(folder: Path) -> Iterator[Path]:
    """The files in a folder of parts that an evaluation wrote: of their names, and with their arrays."""
    for name, arrays in _ARRAYS.items():
        for path in sorted((folder / name).glob("*.npz")):
            if _NAME.fullmatch(path.name) and _arrays_of(path) == arrays:
                yield path


def delete_parts(folder: Path) -> int:
    """Delete the stored parts and nothing else; how many there were."""
    parts = list(stored_parts(folder))
    for path in parts:
        path.unlink()
    return len(parts)


def _arrays_of(path: Path) -> frozenset[str]:
    try:
        with zipfile.ZipFile(path) as archive:
            return frozenset(name.removesuffix(".npy") for name in archive.namelist())
    except (OSError, zipfile.BadZipFile):
        return frozenset()
