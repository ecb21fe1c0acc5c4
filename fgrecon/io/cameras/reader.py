"""The name that `fgrecon.io.cameras.camera_file` had; works for one release more."""

from __future__ import annotations

import warnings
from typing import Any

from fgrecon.io.cameras import camera_file


def __getattr__(name: str) -> Any:
    """What the module has under its name of now."""
    found = getattr(camera_file, name)
    warnings.warn(f"Import {name} from fgrecon.io.cameras.", DeprecationWarning, stacklevel=2)
    return found
