"""The compiled kernels, where they are there and not switched off.

The modules `factors._*`, `fgrecon.solve._native` and `fgrecon.video._egomotion` are built when the package is
installed, if there is a C compiler. Without them, or with the environment variable ``FGRECON_KERNEL`` set to
``numpy``, the numpy versions of the same functions do the work: the same results, several times slower.
"""

from __future__ import annotations

import os
import zlib
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from factors.errors import InvalidInputError

if TYPE_CHECKING:
    from types import ModuleType

_VARIABLE = "FGRECON_KERNEL"
_STALE = "compiled from sources of another version"
_AGAIN = f"Install fgrecon again, which compiles it anew (`pip install -e .`), or set {_VARIABLE}=numpy."
_FOUND: dict[str, ModuleType | None] = {}


class KernelRows:
    """Rows whose arrays a kernel takes once: `compiled` of a class holds them, and copies of rows are without it."""

    KERNEL: ClassVar[str]
    """Name of the kernel's module."""

    @property
    def kernel(self) -> Any:
        """The module of the compiled rows, or None."""
        return native(self.KERNEL)

    def __getstate__(self) -> dict[str, Any]:
        """What they are made of; another process compiles them again."""
        return {name: value for name, value in vars(self).items() if name != "compiled"}


def native(name: str) -> ModuleType | None:
    """A compiled module by its name, or None where it was not built or is switched off.

    Raises:
        InvalidInputError: The environment variable has another value, or the module was compiled from other sources
            than those beside it.
    """
    choice = os.environ.get(_VARIABLE)
    if choice:
        if choice != "numpy":
            raise InvalidInputError(_VARIABLE, choice, "Set the environment variable to numpy, or not at all.")
        return None
    if name not in _FOUND:
        _FOUND[name] = _found(name)
    return _FOUND[name]


def _found(name: str) -> ModuleType | None:
    try:
        module = import_module(name)
    except ImportError as error:
        if error.name == name:
            return None
        raise InvalidInputError(name, _STALE, _AGAIN) from error  # it wants a constant that is no longer there
    source = Path(str(module.__file__)).with_name(name.rpartition(".")[2] + ".pyx")
    parts = [part.read_bytes() for part in (source, source.with_suffix(".pxd")) if part.exists()]
    if parts and getattr(module, "SOURCES", None) != zlib.crc32(b"".join(parts)):
        raise InvalidInputError(name, _STALE, _AGAIN)
    return module
