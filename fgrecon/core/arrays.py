"""Type aliases of arrays, for all rooms."""

from __future__ import annotations

from factors.arrays import Array

__all__ = ["Array"]
