"""Lines of text and the numbers in them, in the manner of KITTI's files."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from fgrecon.core.arrays import Array
from fgrecon.core.errors import InvalidInputError
from fgrecon.io.files import read_text


def filled_lines(path: Path, field: str, fix: str = "") -> Iterator[tuple[str, str]]:
    """The lines of a file that are not blank, each after its place for an error: `file:number`.

    Args:
        field: What an error calls the file, where it cannot be read.
        fix: What to give instead; empty for what is wrong with it.
    """
    for number, line in enumerate(read_text(path, field, fix).splitlines(), start=1):
        if line.strip():
            yield f"{path}:{number}", line


def named_lines(path: Path, field: str = "calibration") -> Mapping[str, list[str]]:
    """The words of each line `name: words`; KITTI's tracking set has no colon after some names.

    Raises:
        InvalidInputError: The file cannot be read, or has two lines of a name that differ.
    """
    found: dict[str, list[str]] = {}
    for _, line in filled_lines(path, field):
        before, colon, after = line.partition(":")
        name, *words = [before.strip(), *after.split()] if colon else line.split()
        if found.setdefault(name, words) != words:
            raise InvalidInputError(f"{path}: {name}", "two such lines that differ", "Give one.")
    return found


def named_matrix(lines: Mapping[str, list[str]], name: str, shape: tuple[int, int], path: Path) -> Array:
    """The matrix of a line, row by row.

    Raises:
        InvalidInputError: There is no such line, or it has other numbers; names it.
    """
    where = f"{path}: {name}"
    if name not in lines:
        raise InvalidInputError(where, "no such line", "Give the file as the data set has it.")
    return numbers(lines[name], shape[0] * shape[1], where).reshape(shape)


def named_pose(lines: Mapping[str, list[str]], name: str, path: Path) -> Array:
    """(4, 4) of the twelve numbers of a line."""
    return as_pose(named_matrix(lines, name, (3, 4), path))


def as_pose(values: Array) -> Array:
    """(4, 4) of twelve numbers [R | t]."""
    return np.vstack([values.reshape(3, 4), [0.0, 0.0, 0.0, 1.0]])


def numbers(words: Sequence[str], count: int, where: str, fix: str = "") -> Array:
    """So many numbers.

    Raises:
        InvalidInputError: They are others, or not finite.
    """
    try:
        values = np.array(words, dtype=np.float64)
    except ValueError:
        values = np.zeros(0)
    if len(values) != count or not np.isfinite(values).all():
        raise InvalidInputError(where, " ".join(words), fix or f"Give {count} numbers.")
    return values
