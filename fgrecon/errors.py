"""The errors that fgrecon raises on purpose: all derive from `FgreconError`."""

from fgrecon.core.errors import DegenerateProblemError, FactorCallbackError, FgreconError, InvalidInputError

__all__ = ["DegenerateProblemError", "FactorCallbackError", "FgreconError", "InvalidInputError"]
