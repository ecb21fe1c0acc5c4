"""The errors that fgrecon raises on purpose, all derived from `FgreconError`, and its warning."""

from fgrecon.core.errors import (
    AssumedCameraWarning,
    ChildNotBegunError,
    DamagedFileWarning,
    DegenerateProblemError,
    FactorCallbackError,
    FgreconError,
    InvalidInputError,
    MissingPackageError,
)

__all__ = [
    "AssumedCameraWarning",
    "ChildNotBegunError",
    "DamagedFileWarning",
    "DegenerateProblemError",
    "FactorCallbackError",
    "FgreconError",
    "InvalidInputError",
    "MissingPackageError",
]
