"""The errors that fgrecon raises on purpose, all derived from `FgreconError`, and its warnings."""

from fgrecon.core.errors import (
    AssumedCameraWarning,
    ChildNotBegunError,
    ContradictoryInputWarning,
    DamagedFileWarning,
    DegenerateProblemError,
    FactorCallbackError,
    FgreconError,
    InvalidInputError,
    MissingPackageError,
    UncoveredFramesWarning,
)

__all__ = [
    "AssumedCameraWarning",
    "ChildNotBegunError",
    "ContradictoryInputWarning",
    "DamagedFileWarning",
    "DegenerateProblemError",
    "FactorCallbackError",
    "FgreconError",
    "InvalidInputError",
    "MissingPackageError",
    "UncoveredFramesWarning",
]
