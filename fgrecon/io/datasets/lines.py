"""Numbers in lines of text, as KITTI's data sets have them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from fgrecon.core.arrays import Array
from fgrecon.core.errors import InvalidInputError
from fgrecon.io.files import read_text


def named_lines(path: Path) -> Mapping[str, list[str]]:
    """The words of each line `name: words`.

    Raises:
        InvalidInputError: The file cannot be read.
    """
    lines = (line.partition(":") for line in read_text(path, "calibration").splitlines())
    return {name.strip(): values.split() for name, _, values in lines}


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
    """(4, 4) of the twelve numbers of a line.

    Raises:
        InvalidInputError: As `named_matrix` raises it.
    """
    return as_pose(named_matrix(lines, name, (3, 4), path))


def as_pose(values: Array) -> Array:
    """(4, 4) of twelve numbers [R | t]."""
    return np.vstack([values.reshape(3, 4), [0.0, 0.0, 0.0, 1.0]])


def numbers(words: Sequence[str], count: int, where: str) -> Array:
    """So many numbers.

    Raises:
        InvalidInputError: They are others, or not finite.
    """
    try:
        values = np.array(words, dtype=np.float64)
    except ValueError:
        raise InvalidInputError(where, " ".join(words)[:80], f"Give {count} numbers.") from None
    if len(values) != count or not np.isfinite(values).all():
        raise InvalidInputError(where, " ".join(words)[:80], f"Give {count} numbers.")
    return values
