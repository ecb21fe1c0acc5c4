"""Typed errors of the factor layer; `fgrecon.core.errors` re-exports them all."""

from __future__ import annotations

from typing import Any

_SHOWN_CHARACTERS = 120


class FgreconError(Exception):
    """Base class of every error that fgrecon raises on purpose."""


class InvalidInputError(FgreconError, ValueError):
    """An argument, file or field has a value that cannot be used.

    Attributes:
        field: Name of the argument or field, as the caller knows it.
        value: The offending value (or the offending part of it).
        fix: What to do about it, as an imperative sentence.
    """

    def __init__(self, field: str, value: object, fix: str) -> None:
        self.field = field
        self.value = value
        self.fix = fix
        super().__init__(f"{field}: got {_shorten(value)}. {fix}")

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle, as from a worker process: a value that is not plain goes as its text."""
        value = self.value if isinstance(self.value, str | int | float | None) else _shorten(self.value)
        return type(self), (self.field, value, self.fix)


class DegenerateProblemError(InvalidInputError):
    """The input is well formed but does not determine an answer (collinear points, no weight left)."""


class FactorCallbackError(FgreconError, RuntimeError):
    """A factor's callback returned something that GTSAM cannot survive (wrong shape, not finite)."""


def _shorten(value: object) -> str:
    text = " ".join((value if isinstance(value, str) else repr(value)).split())
    return text if len(text) <= _SHOWN_CHARACTERS else text[: _SHOWN_CHARACTERS - 3] + "..."
