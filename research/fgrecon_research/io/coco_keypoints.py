"""Where labels of keypoints were read and written before: `fgrecon.io.coco_keypoints`; works for one release more."""

from __future__ import annotations

import warnings
from typing import Any

from fgrecon.io import coco_keypoints


def __getattr__(name: str) -> Any:
    """What the module has under its name of now."""
    found = getattr(coco_keypoints, name)
    warnings.warn(f"Import {name} from fgrecon.io.coco_keypoints.", DeprecationWarning, stacklevel=2)
    return found
