"""LAPACK, as scipy has it compiled, without the rest of `scipy.linalg`: a third of what a first solve imports."""

from __future__ import annotations

import sys
from functools import cache
from importlib.machinery import EXTENSION_SUFFIXES
from importlib.util import find_spec, module_from_spec, spec_from_file_location
from pathlib import Path
from typing import Any

_NAME = "scipy.linalg._flapack"


@cache
def lapack() -> Any:
    """The module with LAPACK's functions, imported on use; it brings a thread pool of its own.

    Where scipy has another layout it is `scipy.linalg.lapack`, of the same functions.
    """
    spec = find_spec("scipy")
    if "scipy.linalg" not in sys.modules and spec is not None and spec.origin is not None:
        import scipy  # noqa: F401 - it finds the libraries that the module needs

        for suffix in EXTENSION_SUFFIXES:
            file = Path(spec.origin).parent / "linalg" / f"_flapack{suffix}"
            own = spec_from_file_location(_NAME, file) if file.is_file() else None
            if own is not None and own.loader is not None:
                module = module_from_spec(own)
                own.loader.exec_module(module)
                return sys.modules.setdefault(_NAME, module)  # scipy.linalg takes it from there
    from scipy.linalg import lapack as public

    return public


def pivots_of_qr(matrix: Any) -> Any:
    """The columns of a matrix in the order in which QR decomposition with pivoting takes them, from 0."""
    work = int(lapack().dgeqp3(matrix, lwork=-1)[3][0])
    return lapack().dgeqp3(matrix, lwork=work)[1] - 1
