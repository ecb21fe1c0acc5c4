"""Lazy import of a package's public names."""

from __future__ import annotations

import ast
import importlib
import sys
from collections.abc import Callable
from typing import Any


def lazy_names(package: str) -> tuple[Callable[[str], Any], Callable[[], list[str]]]:
    """`__getattr__` and `__dir__` (PEP 562) for a package whose `__init__` imports under `if TYPE_CHECKING:` alone.

    Type checkers read these imports, and so does this function: each name comes from the module that it is written to
    come from, when it is first asked for; from the package itself come its modules. So `import fgrecon` costs nothing
    that is not used.

    Args:
        package: `__name__` of the package.
    """
    module = sys.modules[package]
    homes = _homes(module.__loader__.get_source(package))  # type: ignore[union-attr]

    def get(name: str) -> Any:
        if name not in homes:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        if homes[name] == package:
            value: Any = importlib.import_module(f"{package}.{name}")
        else:
            value = getattr(importlib.import_module(homes[name]), name)
        setattr(module, name, value)
        return value

    return get, lambda: sorted({*vars(module), *homes})


def _homes(source: str) -> dict[str, str]:
    """The module that each name is imported from."""
    blocks = [node.body for node in ast.parse(source).body if isinstance(node, ast.If)]
    imports = [node for body in blocks for node in body if isinstance(node, ast.ImportFrom)]
    return {alias.name: node.module for node in imports for alias in node.names if node.module is not None}
