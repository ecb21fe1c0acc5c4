"""pyarrow without pandas, which it imports with the first numbers that it is given, where pandas is installed."""

from __future__ import annotations

import sys
from typing import Any


class _NoPandas:
    """Says that pandas is not installed."""

    @staticmethod
    def find_spec(name: str, path: Any = None, target: Any = None) -> None:  # noqa: ARG004 - the import system's
        if name == "pandas":
            raise ModuleNotFoundError("No module named 'pandas'", name=name)


def without_pandas() -> None:
    """Let pyarrow do without pandas in this process, until somebody asks it for a frame of pandas; saves half a second.

    For processes of our own: whatever another thread imports meanwhile finds no pandas.
    """
    if "pandas" in sys.modules:
        return
    import pyarrow as pa

    sys.meta_path.insert(0, _NoPandas)
    try:
        pa.array([0])
    finally:
        sys.meta_path.remove(_NoPandas)
