"""Files that are no keypoints but are taken for such: the command that reads them is named."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from fgrecon.core.errors import InvalidInputError
from fgrecon.io.images import IMAGES
from fgrecon.io.video_frames import VIDEOS

__all__ = ["refuse_other_file", "refuse_results"]

_ROWS = (".jsonl", ".ndjson", ".parquet")


def refuse_other_file(path: Path) -> None:
    """Refuse a file whose name says that it holds no keypoints that are read whole.

    Raises:
        InvalidInputError: It is a video, an image, or a table; names the command.
    """
    ending = path.suffix.lower()
    if ending in VIDEOS:
        what, fix = "A video", "give it to `fgrecon run`, which follows cars, or to `fgrecon batch`."
    elif ending in IMAGES:
        what, fix = "An image", "give it to `fgrecon reconstruct`; images of a drive to `fgrecon run`."
    elif ending in _ROWS:
        what, fix = "A file of rows", "give it to `fgrecon batch`."
    else:
        return
    if path.is_file():  # else whoever opens it says so
        raise InvalidInputError("file", str(path), f"{what}: {fix}")


def refuse_results(data: Any, where: str) -> None:
    """Refuse what fgrecon has written, which has results in the place of keypoints.

    Args:
        data: The content of a JSON file.
        where: Put in front of the field that the error names.

    Raises:
        InvalidInputError: It is such; names the command.
    """
    kind = data.get("format") if isinstance(data, Mapping) else None
    if isinstance(kind, str) and kind.startswith("fgrecon."):
        fix = "These are results: give the keypoints. `fgrecon export` makes files for other programs of results."
        raise InvalidInputError(f"{where}format", kind, fix)
