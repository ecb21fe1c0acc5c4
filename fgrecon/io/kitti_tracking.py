"""KITTI's tracking files: a line is the frame, the number of the track, and an object's label or result."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.errors import InvalidInputError
from fgrecon.io.kitti_files import LABEL_COLUMNS, Objects, format_results, parse_object

__all__ = ["TrackedObjects", "format_tracking", "read_tracking"]

_FIX = "Give lines of frame, track and an object label."


@dataclass(frozen=True, eq=False)
class TrackedObjects:
    """The M objects of one frame.

    Attributes:
        objects: What they are and where.
        tracks: (M,) number of the track of each; -1 for none.
    """

    objects: Objects
    tracks: NDArray[np.int64]


def read_tracking(path: Path, fix: str = _FIX, *, results: bool = True) -> dict[int, TrackedObjects]:
    """The objects of a file of labels, or of results with scores, by frame; a frame that has none is not there.

    Args:
        path: Text file.
        fix: What to do where it cannot be read, for the error.
        results: Whether lines may have a score after the label.

    Raises:
        InvalidInputError: The file cannot be read, or a line has another format; names file and line.
    """
    try:
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise InvalidInputError("labels", str(path), fix) from error
    rows: dict[int, list[tuple[int, str, list[float]]]] = defaultdict(list)
    for number, line in enumerate(lines, start=1):
        if not line.strip():
            continue
        try:
            frame, track, rest = line.split(maxsplit=2)
            scored = results and len(rest.split()) > LABEL_COLUMNS
            kind, numbers = parse_object(rest, scored=scored)
            known = int(np.int64(int(frame))), int(np.int64(int(track)))
            rows[known[0]].append((known[1], kind, numbers if scored else [*numbers, np.nan]))
        except (ValueError, OverflowError) as error:
            raise InvalidInputError(f"{path}:{number}", str(error), _FIX) from error
    return {
        frame: TrackedObjects(
            Objects.of_rows([kind for _, kind, _ in found], np.array([numbers for _, _, numbers in found])),
            np.array([track for track, _, _ in found], dtype=np.int64),
        )
        for frame, found in rows.items()
    }


def format_tracking(frames: Mapping[int, TrackedObjects]) -> str:
    """Lines of KITTI's tracking results: frame, track, and the columns of a result."""
    lines = []
    for frame, found in sorted(frames.items()):
        results = format_results(found.objects).splitlines(keepends=True)
        lines += [f"{frame} {track} {line}" for track, line in zip(found.tracks.tolist(), results, strict=True)]
    return "".join(lines)
