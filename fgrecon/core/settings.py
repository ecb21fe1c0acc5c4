"""Settings as frozen dataclasses whose fields say what they take: checked once, where they are made.

A group of settings is written as::

    @dataclass(frozen=True)
    class Example:
        sigma: float = number(0.03, least=1e-6)
        joint: bool = flag(default=True)

        def __post_init__(self) -> None:
            check_settings(self, "options.example")
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import field, fields
from enum import StrEnum
from functools import cache
from numbers import Integral, Real
from typing import Any, TypeVar

import numpy as np

from fgrecon.core.checks import as_flag
from fgrecon.core.errors import InvalidInputError

Kind = TypeVar("Kind", bound=StrEnum)
_CHECK = "check"
Check = Callable[[str, Any], Any]
"""Name of a field and its value -> the value as it is to be; raises `InvalidInputError`."""


def number(default: float | None, *, least: float, most: float = math.inf) -> Any:
    """A finite number from `least` to `most`; None is taken where it is the default."""

    def check(name: str, value: Any) -> float:
        if not _is(value, Real) or not (least <= value <= most and _is_float(value)):
            wanted = f"from {least:g} to {most:g}" if math.isfinite(most) else f"of at least {least:g}"
            raise InvalidInputError(name, value, f"Give a finite number {wanted}.")
        return float(value)

    return field(default=default, metadata={_CHECK: _or_none(check, default)})


def count(default: int | None, *, least: int, most: int | None = None) -> Any:
    """A whole number from `least` to `most`; None is taken where it is the default."""

    def check(name: str, value: Any) -> int:
        if not _is(value, Integral) or value < least or (most is not None and value > most):
            wanted = f"from {least}" if most is None else f"from {least} to {most}"
            raise InvalidInputError(name, value, f"Give a whole number {wanted}.")
        return int(value)

    return field(default=default, metadata={_CHECK: _or_none(check, default)})


def flag(default: bool) -> Any:
    """True or False."""
    return field(default=default, metadata={_CHECK: as_flag})


def choice(default: StrEnum) -> Any:
    """A member of the default's enumeration, or its name."""
    return field(default=default, metadata={_CHECK: lambda name, value: one_of(type(default), name, value)})


def choice_or_none(kind: type[StrEnum]) -> Any:
    """A member of an enumeration, or its name; or None, which is the default."""
    return field(
        default=None, metadata={_CHECK: lambda name, value: None if value is None else one_of(kind, name, value)}
    )


def one_of(kind: type[Kind], name: str, value: Any) -> Kind:
    """The member of an enumeration by its name.

    Raises:
        InvalidInputError: There is none of that name.
    """
    try:
        return kind(value)
    except ValueError:
        raise InvalidInputError(name, value, f"Use one of {', '.join(kind)}.") from None


def check_settings(settings: Any, name: str) -> None:
    """Check every field that was made by a function of this module, and bring it to its type.

    Args:
        settings: A frozen dataclass, in its `__post_init__`.
        name: What errors put in front of the field's name.

    Raises:
        InvalidInputError: A field has the wrong type or is out of range.
    """
    for field_name, full_name, check in _checks(settings.__class__, name):
        object.__setattr__(settings, field_name, check(full_name, getattr(settings, field_name)))


@cache
def _checks(kind: type, name: str) -> list[tuple[str, str, Check]]:
    """Name, name in errors and check of every field that has one."""
    entries = [(entry.name, entry.metadata.get(_CHECK)) for entry in fields(kind)]
    return [(entry, f"{name}.{entry}", check) for entry, check in entries if check is not None]


def _is(value: Any, kind: type) -> bool:
    return isinstance(value, kind) and not isinstance(value, bool | np.bool_)


def _or_none(check: Check, default: Any) -> Check:
    return check if default is not None else lambda name, value: None if value is None else check(name, value)


def _is_float(value: Real) -> bool:
    """Whether a number is finite; a whole number may lie beyond the range of floats."""
    try:
        return math.isfinite(value)
    except OverflowError:
        return False
