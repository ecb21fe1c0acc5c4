"""Integrity of files: hashes of those of the package, and parts that a later run takes over."""

from __future__ import annotations

import hashlib
import warnings
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import TypeVar

from fgrecon.core.errors import DamagedFileWarning, InvalidInputError

MADE_AGAIN = "It is made again."
"""What an error of a reader says to do about a damaged part."""

T = TypeVar("T")


def stored(path: Path, read: Callable[[Path], T]) -> T | None:
    """What a file holds, or None where there is none; a damaged one is put aside as `_NAME.damaged`.

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


LIST = "SHA256SUMS"
"""Name of the list in a file's folder, as `sha256sum` writes it and checks it."""


def check_hash(path: Path, content: bytes) -> None:
    """Refuse content that is not what the list in the file's folder says; nothing where no list names the file.

    Raises:
        InvalidInputError: The content is another.
    """
    wanted = listed(path.parent).get(path.name)
    if wanted is not None and hashlib.sha256(content).hexdigest() != wanted:
        fix = f"It is not what {LIST} says: install fgrecon again, or take the file's line out of that list."
        raise InvalidInputError(str(path), "changed or damaged", fix)


def file_hash(path: Path) -> str:
    """SHA-256 of a file's content in hexadecimal digits; the file may be larger than the memory.

    Raises:
        InvalidInputError: It cannot be read.
    """
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        reason = error.strerror or str(error)
        raise InvalidInputError(str(path), reason, "Give a file that can be read.") from error


@cache
def listed(folder: Path) -> dict[str, str]:
    """SHA-256 in hexadecimal digits by the name of the file; empty where the folder has no list."""
    path = folder / LIST
    if not path.is_file():
        return {}
    pairs = (line.split(maxsplit=1) for line in path.read_text(encoding="utf-8").splitlines() if line.strip())
    return {name.lstrip("*"): digest for digest, name in pairs}
