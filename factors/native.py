"""The compiled kernels, where they are there and not switched off.

The modules `factors._*`, `fgrecon.solve._native` and `fgrecon.video._egomotion` are built when the package is
installed, if there is a C compiler. Without them, or with the environment variable ``FGRECON_KERNEL`` set to
``numpy``, the numpy versions of the same functions do the work: the same results, several times slower.
"""

from __future__ import annotations

import os
from importlib import import_module
from typing import TYPE_CHECKING

from factors.errors import InvalidInputError

if TYPE_CHECKING:
    from types import ModuleType

_VARIABLE = "FGRECON_KERNEL"
_FOUND: dict[str, ModuleType | None] = {}


def native(name: str) -> ModuleType | None:
    """A compiled module by its name, or None where it was not built or is switched off.

    Raises:
        InvalidInputError: The environment variable has another value.
    """
    choice = os.environ.get(_VARIABLE)
    if choice:
        if choice != "numpy":
            raise InvalidInputError(_VARIABLE, choice, "Set the environment variable to numpy, or not at all.")
        return None
    if name not in _FOUND:
        try:
            _FOUND[name] = import_module(name)
        except ImportError:
            _FOUND[name] = None
    return _FOUND[name]
