"""Arrays of npz files, whose headers are read before their content: a small file can claim to hold a large one."""

from __future__ import annotations

import os
import zipfile
from collections.abc import Iterable
from io import BytesIO
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.errors import InvalidInputError
from fgrecon.io.files import write_bytes

LARGEST = "FGRECON_LARGEST"
"""Environment variable: how many bytes a file may unpack to."""

_LARGEST = 1 << 29
_ENDING = ".npy"
_CHUNK = 1 << 24
_FLOAT = 8  # bytes of a number once it is used: who reads an array of bytes makes floats of them


def largest_bytes() -> int:
    """How many bytes a file may unpack to.

    Raises:
        InvalidInputError: The environment variable is no positive whole number.
    """
    given = os.environ.get(LARGEST, str(_LARGEST))
    if not given.isascii() or not given.isdigit() or int(given) < 1:
        raise InvalidInputError(LARGEST, given, "Give a positive whole number of bytes.")
    return int(given)


def read_limited(path: Path, field: str) -> bytes:
    """The content of a file that has at most `largest_bytes`; an error names a field.

    Raises:
        InvalidInputError: It cannot be read, or is larger.
    """
    try:
        if path.stat().st_size > largest_bytes():
            raise InvalidInputError(field, str(path), f"Give a file of at most {largest_bytes()} bytes.")
        return path.read_bytes()
    except OSError as error:
        raise InvalidInputError(field, str(path), f"Give a file that can be read ({error.strerror}).") from error


def read_arrays(
    content: bytes | Path, name: str, fix: str, fields: Iterable[str] | None = None
) -> dict[str, NDArray[Any]]:
    """The arrays of an npz file, without pickled content.

    Args:
        content: The file's bytes, or where it is.
        fields: Those that are wanted, as far as they are there; None for all.

    Raises:
        InvalidInputError: It is none, is damaged, has pickled content, or unpacks to more than
            `largest_bytes`, with 8 bytes for each number.
        FileNotFoundError: There is no such file.
    """
    wanted = None if fields is None else set(fields)
    limit, arrays, field = largest_bytes(), {}, ""
    try:
        with zipfile.ZipFile(BytesIO(content) if isinstance(content, bytes) else content) as archive:
            members = [one for one in archive.infolist() if one.filename.endswith(_ENDING)]
            members = [one for one in members if wanted is None or one.filename.removesuffix(_ENDING) in wanted]
            _check_room(sum(one.file_size for one in members), name, limit)
            room = 0
            for member in members:
                field = member.filename.removesuffix(_ENDING)
                with archive.open(member) as file:
                    shape, fortran, kind, count = _header(file, member.file_size)
                    room += count * max(kind.itemsize, _FLOAT if kind.kind in "biuf" else 1)
                    _check_room(room, name, limit)
                    arrays[field] = _content(file, kind, count).reshape(shape, order="F" if fortran else "C")
    except FileNotFoundError:
        raise
    except InvalidInputError:
        raise
    except Exception as error:  # numpy and zipfile promise no kind of error for damaged content
        pickled = "pickle" in str(error)
        value = "pickled content, which could run code" if pickled else f"unreadable: {error}"
        raise InvalidInputError(f"{name}: {field}" if field else name, value, fix) from error
    return arrays


def write_arrays(path: Path, *, compressed: bool = False, **arrays: NDArray[Any]) -> Path:
    """Write arrays as an npz file, whole or not at all; the path."""
    content, save = BytesIO(), np.savez_compressed if compressed else np.savez
    save(content, allow_pickle=False, **arrays)
    return write_bytes(path, content.getvalue())


def read_lone_array(content: bytes, name: str, fix: str) -> NDArray[Any]:
    """The array of an npy file, without pickled content.

    Raises:
        InvalidInputError: It is none, is damaged, or has pickled content.
    """
    try:
        file = BytesIO(content)
        shape, fortran, kind, count = _header(file, len(content))
        return _content(file, kind, count).reshape(shape, order="F" if fortran else "C")
    except Exception as error:  # numpy promises no kind of error for damaged content
        raise InvalidInputError(name, f"unreadable: {error}", fix) from error


def _header(file: IO[bytes], size: int) -> tuple[tuple[int, ...], bool, np.dtype[Any], int]:
    """Shape, order, kind and number of the elements of a member of so many bytes."""
    version = np.lib.format.read_magic(file)
    header = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    shape, fortran, kind = header(file)
    if kind.hasobject:
        raise ValueError("pickled content")
    count = 1
    for side in shape:  # of Python's whole numbers, which do not overflow
        count *= side
    if count < 0 or count * kind.itemsize > size:
        raise ValueError(f"an array of shape {shape} in {size} bytes")
    return shape, fortran, kind, count


def _content(file: IO[bytes], kind: np.dtype[Any], count: int) -> NDArray[Any]:
    """The elements that follow a header, read to where they stay."""
    if not kind.itemsize:
        return np.zeros(count, kind)
    data = bytearray(count * kind.itemsize)
    room, read = memoryview(data), 0
    while read < len(data):
        got = file.readinto(room[read : read + _CHUNK])  # type: ignore[attr-defined]  # of every binary file
        if not got:
            raise ValueError("cut off")
        read += got
    return np.frombuffer(data, dtype=kind, count=count)


def _check_room(room: int, name: str, limit: int) -> None:
    if room > limit:
        fix = f"Give a smaller file; {limit} bytes are allowed, and the environment variable {LARGEST} raises that."
        raise InvalidInputError(name, f"{room} bytes when unpacked", fix)
