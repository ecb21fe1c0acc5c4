"""Lines of YOLO's pose models, a vehicle each, as labels or as ultralytics' `save_txt` writes them.

    class x y width height u1 v1 c1 u2 v2 c2 ... [score] [track]

Box (its centre) and points are shares of the image, whose size is given by its file: of the same name beside the lines,
or in `images` where they are in `labels`. Points have two numbers, or three: whole ones are COCO's flags, 0 not there,
1 hidden and 2 seen; others are probabilities. A point at the image's corner is none. A lone whole number at the end is
the track: ultralytics writes it without a score by default.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from fgrecon.core.category import Category
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.observation import Observation
from fgrecon.io.files import read_text
from fgrecon.io.images import IMAGES, read_image
from fgrecon.io.keypoints.network_results import PROBABLE

Record = dict[str, Any]

_BOX, _BEHIND = 5, 2  # numbers before the points, and at most behind them


def is_yolo_pose(path: Path) -> bool:
    """Whether lines are YOLO's and not CarFusion's, which have commas."""
    text = read_text(path, "file")
    return bool(text.strip()) and "," not in text


def yolo_pose_records(path: Path, category: Category) -> Iterator[tuple[Record | InvalidInputError, str]]:
    """The vehicles in the layout of a keypoint file, their points in the order of the lines.

    Args:
        path: The lines.
        category: The category whose keypoints are wanted: where its size fits, points have as many numbers as that
            tells; else three.

    Raises:
        InvalidInputError: The file cannot be read, or its image is not there.
    """
    lines = read_text(path, "file").splitlines()
    image = _image(path)
    height, width = read_image(image).shape[:2]
    for number, line in enumerate(lines, start=1):
        if not line.strip():
            continue
        where = f"{path}:{number}: "
        try:
            yield {"id": number} | _record(line, where, (width, height), category) | {"image": image.name}, where
        except InvalidInputError as error:
            yield error, where


def _image(path: Path) -> Path:
    folders = [path.parent]
    if "labels" in path.parts[:-1]:
        place = len(path.parts) - 2 - path.parts[-2::-1].index("labels")
        folders.append(Path(*path.parts[:place], "images", *path.parts[place + 1 : -1]))
    there = (folder / f"{path.stem}{ending}" for folder in folders for ending in IMAGES)
    found = next((file for file in there if file.is_file()), None)
    if found is None:
        fix = f"Put {path.stem}.jpg beside it, or into images beside labels: the points are shares of its size."
        raise InvalidInputError("keypoints", f"{path}, without its image", fix)
    return found


def _record(line: str, where: str, size: tuple[int, int], category: Category) -> Record:
    fix = f"Give `class x y width height` and {category.size} points of 2 or 3 numbers, shares of the image."
    try:
        values = [float(word) for word in line.split()]
    except ValueError:
        values = []
    rest = len(values) - _BOX
    if rest < 2 or not all(map(math.isfinite, values)):
        raise InvalidInputError(where.removesuffix(": "), line[:80], fix)
    each = 2 if 0 <= rest - 2 * category.size <= _BEHIND else 3
    count = category.size if 0 <= rest - each * category.size <= _BEHIND else rest // each
    points = [values[_BOX + each * i : _BOX + each * (i + 1)] for i in range(count)]
    behind = values[_BOX + each * count :]
    trusts = [point[2] for point in points] if each == 3 else []
    flags = all(trust in (0.0, 1.0, 2.0) for trust in trusts)
    u, v, width, height = (value * side for value, side in zip(values[1:_BOX], [*size, *size], strict=True))
    record: Record = {
        "keypoints": [_point(point, size, flags=flags) for point in points],
        "box": [u - width / 2, v - height / 2, u + width / 2, v + height / 2],
    }
    if not flags:
        record["confidence_midpoint"] = PROBABLE
    if len(behind) > 1 or (behind and behind[0] % 1):
        record["score"] = behind.pop(0)
    if behind:
        record["track"] = int(behind[0])
    return record


def _point(point: list[float], size: tuple[int, int], *, flags: bool) -> list[float] | None:
    """A point in pixels; None where it is none."""
    trust = point[2] if len(point) > 2 else 2.0
    if trust <= 0.0 or point[:2] == [0.0, 0.0]:
        return None
    if flags:
        trust = Observation.confidence_midpoint if trust == 1.0 else 1.0
    return [point[0] * size[0], point[1] * size[1], min(trust, 1.0)]
