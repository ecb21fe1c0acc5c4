"""Instances of CarFusion's annotations: a text file for each image, a line `u, v, keypoint, car, visibility` a point.

Keypoints count from 1, in CarFusion's order. Visibility 2 is a hidden point; 1 and 3 count as seen, as in the data
set's own conversion to COCO.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from fgrecon.core.errors import InvalidInputError
from fgrecon.core.observation import Observation
from fgrecon.io.keypoints.names import scheme_keypoints

__all__ = ["carfusion_records"]

_COLUMNS = 5
_CONFIDENCE = {1.0: 1.0, 2.0: Observation.confidence_midpoint, 3.0: 1.0}


def carfusion_records(path: Path) -> Iterator[tuple[dict[str, Any], str]]:
    """Instances of one file in the layout of a keypoint file, and what errors about each begin with.

    Points at or beyond the image's upper and left edge are CarFusion's for "outside", and left out.

    Raises:
        InvalidInputError: The file cannot be read, or a line is malformed; names it.
    """
    try:
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    except OSError as error:
        raise InvalidInputError("file", str(path), f"Give a file that can be read ({error.strerror}).") from error
    except UnicodeDecodeError as error:
        raise InvalidInputError(str(path), "no text", "Give a text file in UTF-8.") from error
    order = scheme_keypoints("carfusion")
    cars: dict[int, dict[str, list[float]]] = {}
    for number, line in enumerate(lines, start=1):
        if not line.strip():
            continue
        u, v, keypoint, car, visibility = _numbers(line, f"{path}:{number}", len(order))
        points = cars.setdefault(int(car), {})
        if u > 0 and v > 0:
            points[order[int(keypoint) - 1]] = [u, v, _CONFIDENCE[visibility]]
    if not any(cars.values()):
        raise InvalidInputError(str(path), "no point", "Give a file with at least one car.")
    for car, points in cars.items():
        if points:
            yield {"id": car, "image": f"{path.stem}.jpg", "keypoints": points}, f"{path}: car {car}: "


def _numbers(line: str, where: str, count: int) -> list[float]:
    try:
        values = [float(part) for part in line.split(",")]
    except ValueError:
        values = []
    whole = len(values) == _COLUMNS and all(map(math.isfinite, values)) and all(x.is_integer() for x in values[2:])
    if not whole or not 1 <= values[2] <= count or values[4] not in _CONFIDENCE:
        fix = f"Give `u, v, keypoint, car, visibility` as CarFusion does: keypoint 1 to {count}, visibility 1, 2 or 3."
        raise InvalidInputError(where, line, fix)
    return values
