"""Text files by their lines and numbers, as KITTI's are; files written whole or not at all; and hashes of files."""

from __future__ import annotations

import errno
import glob
import hashlib
import os
import shutil
import tempfile
import time
import warnings
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from typing import TypeVar

import numpy as np

from fgrecon.core.arrays import Array
from fgrecon.core.errors import DamagedFileWarning, InvalidInputError
from fgrecon.core.text import whole_text

_ABANDONED = 3600.0  # seconds
_PART = ".part"
_TO_WRITE = os.W_OK | os.X_OK  # what a folder allows in which files are made
_LONGEST = 255 - len(f"..????????{_PART}")
"""Bytes of a name that the names of its parts have in them; longer ones have its hash."""


def read_text(path: Path, field: str, fix: str = "") -> str:
    """The text of a file (UTF-8, a byte order mark left out).

    Args:
        field: What an error calls it, where it cannot be read.
        fix: What to give instead; empty for what is wrong with the file.
    """
    try:
        return path.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise InvalidInputError(field, str(path), fix or f"Give a file that can be read ({error.strerror}).") from error
    except UnicodeDecodeError as error:
        raise InvalidInputError(str(path), "no text", fix or "Give a text file in UTF-8.") from error


def write_text(path: str | Path, text: str) -> Path:
    """Write a text file (UTF-8, line ends as given) whole or not at all; see `write_bytes`.

    Names of files that are not UTF-8 may be in it: what they have instead becomes a replacement character.
    """
    return write_bytes(path, whole_text(text).encode())


def write_bytes(path: str | Path, content: bytes) -> Path:
    """Write a file so that a reader sees the old content or the new, never a part of it.

    The content goes to a temporary file in the same folder, to the disk, and then takes the place of `path` in one
    step. When anything fails, `path` is as before and the temporary file is gone. Missing folders are not created:
    a mistyped path should not succeed. What exists and is no file (a pipe, a device) is written to and stays.

    Returns:
        The path written to.

    Raises:
        InvalidInputError: The folder does not exist or cannot be written to, or `path` is a folder.
    """
    with replacing(path) as part:
        part.write_bytes(content)
    return Path(path)


def behind_links(path: str | Path) -> Path:
    """The absolute path of what a path's links lead to, there or not.

    Raises:
        InvalidInputError: They lead to themselves.
    """
    real = Path(os.path.realpath(path))
    if any(part.is_symlink() for part in (real, *real.parents)):  # here Path.resolve() ends with a RuntimeError
        raise InvalidInputError(str(path), os.strerror(errno.ELOOP), "Give a path whose links lead somewhere.")
    return real


def check_ending(path: str | Path, endings: Collection[str]) -> str:
    """The ending of a file's name, in lower case and without its dot.

    Raises:
        InvalidInputError: It is none of those that can be written.
    """
    kind = Path(path).suffix.lower().removeprefix(".")
    if kind not in endings:
        raise InvalidInputError(str(path), kind or "no ending", f"Let the name end in one of {', '.join(endings)}.")
    return kind


def check_output(path: Path | None) -> None:
    """Refuse an output that cannot be written before the work instead of after it; None is none."""
    if path is None or _is_special(path):
        return
    folder = behind_links(path).parent
    if path.is_dir() or not folder.is_dir():
        raise InvalidInputError("output", str(path), "Give a file in a folder that exists.")
    if not os.access(folder, _TO_WRITE):
        raise InvalidInputError("output", str(path), f"Give another file: {folder} cannot be written to.")


def check_folder(path: Path) -> None:
    """Refuse a folder of results that cannot be made, before the work."""
    there = next(part for part in (path, *behind_links(path).parents) if part.exists())
    if not there.is_dir():
        raise InvalidInputError("out", str(path), f"Give another folder: {there} is a file.")
    if not os.access(there, _TO_WRITE):
        raise InvalidInputError("out", str(path), f"Give another folder: {there} cannot be written to.")


@contextmanager
def text_file(path: str | Path) -> Iterator[Callable[[str], object]]:
    """What adds to the text of a file, which is as of `write_text` when the context ends."""
    with replacing(path) as part, part.open("wb") as file:
        yield lambda text: file.write(whole_text(text).encode())


@contextmanager
def replacing(path: str | Path) -> Iterator[Path]:
    """A temporary file beside `path` to write to, which takes its place as `write_bytes` tells."""
    try:
        if _is_special(Path(path)):
            with _copied_to(Path(path)) as part:
                yield part
            return
        target = behind_links(path)  # the file behind a link is replaced and not the link
        if target.is_dir():
            raise IsADirectoryError(f"{target} is a folder")
        _clear(target)
        descriptor, name = tempfile.mkstemp(dir=target.parent, prefix=_beginning(target), suffix=_PART)
        part = Path(name)
        try:
            with os.fdopen(descriptor, "rb") as file:
                yield part
                os.fsync(file.fileno())
            part.chmod(_mode(target))
            part.replace(target)
        except BaseException:
            part.unlink(missing_ok=True)
            raise
    except OSError as error:
        reason = error.strerror or str(error)
        raise InvalidInputError(
            str(path), reason, "Give a file in a folder that exists and can be written to."
        ) from error


def _is_special(path: Path) -> bool:
    """Whether there is something that is neither a file nor a folder, by links or not: it must not be replaced."""
    return path.exists() and not (path.is_file() or path.is_dir())


@contextmanager
def _copied_to(path: Path) -> Iterator[Path]:
    """A temporary file, whose content goes to a pipe or device at the end: some writers go back in what they write."""
    with tempfile.TemporaryDirectory(prefix="fgrecon-") as folder:
        part = Path(folder) / "part"
        part.touch()
        yield part
        with part.open("rb") as content, path.open("wb", buffering=0) as target:
            shutil.copyfileobj(content, target)


def _clear(target: Path) -> None:
    """Remove what writers that were killed have left of the file: parts that nobody has written to for an hour."""
    for part in target.parent.glob(f"{glob.escape(_beginning(target))}*{_PART}"):
        with suppress(OSError):  # another process has, or may not
            if time.time() - part.stat().st_mtime > _ABANDONED:
                part.unlink()


def _beginning(target: Path) -> str:
    """How the names of a file's parts begin, of which no other file's do; names may have 255 bytes in all."""
    if len(os.fsencode(target.name)) <= _LONGEST:
        return f".{target.name}."
    return f".{hashlib.sha256(os.fsencode(target.name)).hexdigest()}."


def _mode(target: Path) -> int:
    """Permissions of the file that is replaced, else those that the process gives new files."""
    if target.exists():
        return target.stat().st_mode & 0o777
    mask = os.umask(0)  # the mask can only be read by setting it
    os.umask(mask)
    return 0o666 & ~mask


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
    """Refuse content that is not what the list in the file's folder says; nothing where no list names the file."""
    wanted = listed(path.parent).get(path.name)
    if wanted is not None and hashlib.sha256(content).hexdigest() != wanted:
        fix = f"It is not what {LIST} says: install fgrecon again, or take the file's line out of that list."
        raise InvalidInputError(str(path), "changed or damaged", fix)


def file_hash(path: Path) -> str:
    """SHA-256 of a file's content in hexadecimal digits; the file may be larger than the memory."""
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
        InvalidInputError: Two lines of a name differ.
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
