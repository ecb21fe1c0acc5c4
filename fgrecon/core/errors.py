"""Every error that fgrecon raises on purpose, in one place.

All derive from `FgreconError`. Errors about input derive from `InvalidInputError` (a `ValueError`) and name the field,
the value and the fix; the command line turns them into exit code 2.
"""

from factors.errors import (
    DegenerateProblemError,
    FactorCallbackError,
    FgreconError,
    InvalidInputError,
)

__all__ = [
    "DegenerateProblemError",
    "FactorCallbackError",
    "FgreconError",
    "InvalidInputError",
]
