"""Short repr of frozen data: the type and the arrays' shapes instead of every number."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields
from typing import Any

import numpy as np

_FEW = 4
"""So many numbers or texts are shown; of more, and of other things, their count."""


def brief_repr(self: Any) -> str:
    """The `__repr__` of a dataclass that holds arrays: `__repr__ = brief_repr` in its body."""
    shown = ", ".join(f"{field.name}={_brief(getattr(self, field.name))}" for field in fields(self) if field.repr)
    return f"{type(self).__name__}({shown})"


def _brief(value: Any) -> str:
    if isinstance(value, np.ndarray):
        few = value.ndim == 1 and value.size <= _FEW
        return np.array2string(value, precision=6, separator=", ") if few else f"{value.dtype} {value.shape}"
    if isinstance(value, Mapping):
        few = len(value) <= _FEW
        return f"{{{', '.join(f'{k!r}: {_brief(v)}' for k, v in value.items())}}}" if few else f"{len(value)} items"
    if isinstance(value, Sequence) and not isinstance(value, str):
        plain = all(item is None or isinstance(item, str | int | float) for item in value)
        return repr(value) if plain and len(value) <= _FEW else f"{len(value)} items"
    return repr(value).partition("\n")[0]
