"""Kind of an uploaded file, by its name's ending and, of texts, by a glance at the content. Readers check it."""

from __future__ import annotations

import re
from enum import StrEnum
from pathlib import Path

from fgrecon.core.errors import FgreconError
from fgrecon.io.images import IMAGES
from fgrecon.io.video_frames import VIDEOS

_SAFE = re.compile(r"[^\w.-]+")
_LONGEST = 100  # characters of a name
_KEYPOINTS, _BOXES, _CAMERA = (
    re.compile(words.encode())
    for words in ('"keypoints"|"instances"', '"bbox"', '"(K|camera_matrix|camera_intrinsic)"')
)
_LINE = re.compile(rb"\s*[^\n:]*:")  # of a calibration: a name and a colon


class Kind(StrEnum):
    """What an uploaded file is."""

    PHOTOGRAPH = "photograph"
    VIDEO = "video"
    KEYPOINTS = "keypoints"
    BOXES = "boxes"
    CAMERA = "camera"


def safe_name(name: str) -> str:
    """The name of an uploaded file, as a file in a folder of ours can be called."""
    return (_SAFE.sub("_", Path(name.replace("\\", "/")).name).lstrip(".") or "file")[-_LONGEST:]


def is_video(name: str) -> bool:
    """Whether a name is a video's."""
    return Path(name).suffix.lower() in VIDEOS


def kind_of(name: str, content: bytes) -> Kind:
    """What a file is.

    Raises:
        FgreconError: Nothing that is known.
    """
    ending = Path(name).suffix.lower()
    if ending in IMAGES:
        return Kind.PHOTOGRAPH
    if is_video(name):
        return Kind.VIDEO
    if ending in (".yaml", ".yml"):
        return Kind.CAMERA
    if ending == ".txt":
        return Kind.CAMERA if _LINE.match(content) else Kind.BOXES
    if ending == ".json":
        kinds = {_KEYPOINTS: Kind.KEYPOINTS, _BOXES: Kind.BOXES, _CAMERA: Kind.CAMERA}
        return next((kind for pattern, kind in kinds.items() if pattern.search(content)), Kind.KEYPOINTS)
    raise FgreconError(
        f"{name}: of no known kind. Give a photograph, a video, keypoints (.json), boxes (.txt, .json) or a "
        "calibration (.txt, .yaml, .json)."
    )
