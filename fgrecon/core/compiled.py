"""Compiled parts of scipy without the packages around them, whose imports take a third of a first solve.

`scipy.linalg` brings all of numpy's f2py and testing, `scipy.optimize` most of scipy.
"""

from __future__ import annotations

import sys
from functools import cache
from importlib import import_module
from importlib.machinery import EXTENSION_SUFFIXES
from importlib.util import find_spec, module_from_spec, spec_from_file_location
from pathlib import Path
from typing import Any


@cache
def lapack() -> Any:
    """The module with LAPACK's functions, imported on use; it brings a thread pool of its own."""
    return _compiled("scipy.linalg", "_flapack", "lapack")


def pivots_of_qr(matrix: Any) -> Any:
    """The columns of a matrix in the order in which QR decomposition with pivoting takes them, from 0."""
    work = int(lapack().dgeqp3(matrix, lwork=-1)[3][0])
    return lapack().dgeqp3(matrix, lwork=work)[1] - 1


@cache
def assignment() -> Any:
    """The module with `linear_sum_assignment`, imported on use."""
    return _compiled("scipy.optimize", "_lsap", "")


def _compiled(package: str, name: str, public: str) -> Any:
    """A compiled module of a package of scipy, which that package takes when it is imported later.

    Args:
        name: Of the module.
        public: Of the package's module with the same functions, where scipy has another layout or the package is
            there; empty for the package.
    """
    spec = find_spec("scipy")
    if package not in sys.modules and spec is not None and spec.origin is not None:
        import_module("scipy")  # it finds the libraries that the module needs
        folder = Path(spec.origin).parent / package.rpartition(".")[2]
        for file in (folder / f"{name}{suffix}" for suffix in EXTENSION_SUFFIXES):
            own = spec_from_file_location(f"{package}.{name}", file) if file.is_file() else None
            if own is not None and own.loader is not None:
                module = module_from_spec(own)
                own.loader.exec_module(module)
                return sys.modules.setdefault(f"{package}.{name}", module)
    return import_module(f"{package}.{public}" if public else package)
