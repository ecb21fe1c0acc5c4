"""Reading JSON and TOML files, and JSON field by field, with errors that name the file and the field."""

from __future__ import annotations

import json
import math
import re
import tomllib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.checks import text_named
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.text import whole_text

_SURROGATE = re.compile(r"\\u[dD][89abAB-Fc-f]")
_FLOATS = {float}
_LARGEST = 2**63 - 1
_DIGITS = 19  # of an id that is a number
_ARTICLES = {int: "an integer", str: "a text", list: "a list", dict: "an object"}


def read_json(path: Path) -> Any:
    """The content of a JSON file."""
    try:
        return parse_json(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InvalidInputError("file", str(path), f"Give a file that can be read ({error.strerror}).") from error
    except (ValueError, RecursionError) as error:
        raise InvalidInputError(str(path), str(error), "Give a JSON file in UTF-8.") from error


def read_fields(path: Path) -> Fields:
    """The fields of a JSON file that holds an object."""
    return Fields(read_json(path), f"{path}: ")


def read_records(path: Path, what: str) -> list[Fields]:
    """The fields of each object of a JSON file that holds a list of them.

    Args:
        what: Of what, for the error: `a list of ...`.
    """
    entries = read_json(path)
    if not isinstance(entries, list):
        raise InvalidInputError(str(path), type(entries).__name__, f"Give {what}.")
    return [Fields(entry, f"{path}: [{number}].") for number, entry in enumerate(entries)]


def parse_json(text: str) -> Any:
    """The content of a JSON text; a byte order mark is passed over.

    Half a pair of surrogates, which JSON can write and no file can hold, becomes a replacement character.

    Raises:
        ValueError: It is not JSON.
        RecursionError: It is nested too deeply.
    """
    content = json.loads(text.removeprefix("\ufeff"))
    return _whole(content) if _SURROGATE.search(text) else content


def _whole(value: Any) -> Any:
    if isinstance(value, str):
        return whole_text(value)
    if isinstance(value, list):
        return [_whole(item) for item in value]
    return {_whole(key): _whole(item) for key, item in value.items()} if isinstance(value, dict) else value


def read_toml(path: Path) -> dict[str, Any]:
    """The content of a TOML file."""
    try:
        return tomllib.loads(path.read_text(encoding="utf-8-sig"))
    except OSError as error:
        raise InvalidInputError("file", str(path), f"Give a file that can be read ({error.strerror}).") from error
    except ValueError as error:  # TOML's errors and those of UTF-8
        raise InvalidInputError(str(path), str(error), "Give a TOML file in UTF-8.") from error


@contextmanager
def within(where: str, names: Mapping[str, str] | None = None) -> Iterator[None]:
    """Put a place in front of the field that an error names.

    Args:
        where: The place, such as `cars.json: instance 3: `.
        names: What the file calls fields that have other names in fgrecon.
    """
    try:
        yield
    except InvalidInputError as error:
        field = error.field.removeprefix(where)
        raise InvalidInputError(where + (names or {}).get(field, field), error.value, error.fix) from error


class Fields:
    """Reads the fields of one JSON object and names the field in every error.

    Attributes:
        data: The object.
        where: Put in front of every field that an error names, such as `cars.json: instance 3: `.
    """

    def __init__(self, data: Any, where: str) -> None:
        """Take the object."""
        if not isinstance(data, Mapping):
            raise InvalidInputError(where.rstrip(".: ") or "file", data, "Give a JSON object.")
        self.data = data
        self.where = where

    def __contains__(self, field: str) -> bool:
        """Whether there is such a field and it is not `null`."""
        return self.data.get(field) is not None

    def get(self, field: str, kind: type) -> Any:
        """A field of a kind (int, str, list or dict)."""
        if field not in self.data:
            raise InvalidInputError(f"{self.where}{field}", "nothing", "Give this field.")
        value = self.data[field]
        if not isinstance(value, kind) or isinstance(value, bool):
            raise InvalidInputError(f"{self.where}{field}", value, f"Give {_ARTICLES[kind]}.")
        return value

    def inner(self, field: str, *, needed: bool = True) -> Fields:
        """The fields of an object in a field; where it is not needed and not there, none."""
        return Fields(self.get(field, dict) if needed or field in self else {}, f"{self.where}{field}.")

    def each(self, field: str, *, needed: bool = True) -> Iterator[Fields]:
        """The objects of a list in a field; where it is not needed and not there, none."""
        for number, item in enumerate(self.get(field, list) if needed or field in self else ()):
            yield Fields(item, f"{self.where}{field}[{number}].")

    def whole(self, field: str, least: int = 0) -> int:
        """An integer that tables have room for (64 bits).

        Raises:
            InvalidInputError: It is missing, no integer, or out of range.
        """
        given = self.data.get(field)
        value: int = int(given) if isinstance(given, float) and given.is_integer() else self.get(field, int)
        if not least <= value <= _LARGEST:
            raise InvalidInputError(f"{self.where}{field}", value, f"Give an integer from {least} to {_LARGEST}.")
        return value

    def numbers(self, field: str, shape: tuple[int, ...], *, missing: bool = False) -> NDArray[np.float64]:
        """An array of exactly this shape; `null` becomes NaN where `missing` allows it, alone or for a whole row.

        Raises:
            InvalidInputError: The field is missing, of another shape, or an element is not a finite number; names the
                element.
        """
        if field not in self.data:
            raise InvalidInputError(f"{self.where}{field}", "nothing", "Give this field.")
        return numbers(self.data[field], shape, f"{self.where}{field}", missing=missing)


def plain_id(value: Any) -> int | str | None:
    """An id whatever way it is written: 1, 1.0 and "1" are one; None where it is none."""
    if isinstance(value, str) and (text := value.strip()):
        number = text.removesuffix(".0")
        plain = number.isascii() and number.isdecimal() and (number == "0" or number[0] != "0")
        return int(number) if plain and len(number) < _DIGITS else text
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    if isinstance(value, float):
        return int(value) if value.is_integer() else None
    return value


def numbers(value: Any, shape: tuple[int, ...], field: str, *, missing: bool = False) -> NDArray[np.float64]:
    """Nested lists as an array; see `Fields.numbers`."""
    if _plain(value, shape):
        found: NDArray[np.float64] = np.array(value, dtype=np.float64)
        if np.isfinite(found).all():
            return found
    array = np.empty(shape)
    _fill(array, (), value, field, missing)
    return array


def _plain(value: Any, shape: tuple[int, ...]) -> bool:
    """Whether a value is nested lists of floats of this shape, of which numpy makes an array as `_fill` does."""
    if not shape:
        return type(value) is float
    if type(value) is not list or len(value) != shape[0]:
        return False
    if len(shape) == 1:
        return set(map(type, value)) == _FLOATS
    return all(_plain(item, shape[1:]) for item in value)


def _fill(array: NDArray[np.float64], at: tuple[int, ...], value: Any, field: str, missing: bool) -> None:
    """Checks leaf by leaf: numpy would take `"NaN"` and `true` for numbers and could not say which leaf is bad."""
    depth = len(at)
    if missing and value is None and depth:
        array[at] = np.nan
        return
    if depth == array.ndim:
        array[at] = _number(value, field)
        return
    length = array.shape[depth]
    if not isinstance(value, list) or len(value) != length:
        got = f"{len(value)} elements" if isinstance(value, list) else value
        raise InvalidInputError(field, got, f"Give a list of {length}.")
    for i, item in enumerate(value):
        _fill(array, (*at, i), item, f"{field}[{i}]", missing)


def _number(value: Any, field: str) -> float:
    try:
        if not isinstance(value, bool) and isinstance(value, int | float) and math.isfinite(value):
            return float(value)
    except OverflowError:  # an integer beyond the range of floats
        pass
    raise InvalidInputError(field, text_named(value), "Give a finite number.")
