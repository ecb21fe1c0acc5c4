"""Every error and warning that fgrecon raises on purpose, in one place.

All errors derive from `FgreconError`. Errors about input derive from `InvalidInputError` (a `ValueError`) and name the
field, the value and the fix; the command line turns them into exit code 2.
"""

import shlex
from typing import Any

from factors.errors import (
    DegenerateProblemError,
    FactorCallbackError,
    FgreconError,
    InvalidInputError,
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


class MissingPackageError(FgreconError, ImportError):
    """Something was asked for that needs a package which is not installed.

    Attributes:
        package: Its name, as pip takes it.
        purpose: What needs it.
        folder: The folder of a checkout of fgrecon that it is in; empty where an index has it.
    """

    def __init__(self, package: str, purpose: str, folder: str = "") -> None:
        self.package, self.purpose, self.folder = package, purpose, folder
        command = shlex.join(["pip", "install", *([f"./{folder}"] if folder else package.split())])
        where = "in a checkout of fgrecon, " if folder else ""
        super().__init__(f"{purpose} needs {package}, which is not installed here. Run: {where}{command}")

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle, as from a worker process."""
        return type(self), (self.package, self.purpose, self.folder)


class ChildNotBegunError(FgreconError, RuntimeError):
    """The process that decodes a file did not begin: that is not about the file, but about the place.

    Attributes:
        why: What happened.
    """

    def __init__(self, why: str) -> None:
        self.why = why
        fix = "Look at what Python printed, at the free memory, and at multiprocessing.set_executable."
        super().__init__(f"The process that decodes files did not begin: {why}. {fix}")

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle, as from a worker process."""
        return type(self), (self.why,)


class AssumedCameraWarning(UserWarning):
    """No camera was given, and a field of view was assumed: distances are rough."""


class UncoveredFramesWarning(UserWarning):
    """What is given by frame, such as the camera's poses, is not of all frames, or of others as well."""


class DamagedFileWarning(UserWarning):
    """A file that an earlier run stored is damaged; what it held is computed again."""


class ContradictoryInputWarning(UserWarning):
    """Keypoints, boxes or a camera contradict one another: results are probably wrong."""
