"""Arrays of floats, by one name in all rooms."""

from __future__ import annotations

from factors.arrays import Array

__all__ = ["Array"]
