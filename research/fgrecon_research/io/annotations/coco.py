"""Reader of keypoint annotations in COCO's JSON format."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.category import Category
from fgrecon.core.errors import InvalidInputError
from fgrecon.io.json_fields import Fields, read_json
from fgrecon_research.io.annotations.annotations import Annotations, in_category_order

_LARGEST = 1e9  # pixels; so no number is infinite or none


def read_coco(path: Path, category: Category, rename: Mapping[str, str]) -> Annotations:
    """Annotations of one COCO file: `categories[].keypoints` names, `annotations[].keypoints` (u, v, flag) x K.

    The flag is COCO's: 0 not labelled, 1 labelled but hidden, 2 labelled and visible; whatever is labelled is used. Of
    several object categories all that share a keypoint name with `category` are read.

    Args:
        rename: From the file's keypoint names to the category's, where they differ.

    Returns:
        The annotations; crowd regions and instances without keypoints are left out.

    Raises:
        InvalidInputError: Not such a file, or a wrong value; names file, instance and keypoint.
    """
    content = Fields(read_json(path), f"{path}: ")
    layouts = _layouts(path, content, category, rename)
    images = {
        entry["id"]: str(entry.get("file_name", entry["id"]))
        for entry in (content.get("images", list) if "images" in content else [])
        if isinstance(entry, Mapping) and isinstance(entry.get("id"), int | str)
    }
    keypoints: list[NDArray[np.float64]] = []
    names: list[str] = []
    for number, entry in enumerate(content.get("annotations", list)):
        identity = entry.get("id", number) if isinstance(entry, dict) else number
        instance = Fields(entry, f"{path}: annotation {identity}: ")
        if "keypoints" not in instance or instance.data.get("iscrowd") == 1:
            continue
        kind = instance.get("category_id", int)
        if kind not in layouts:
            continue
        file_names, columns = layouts[kind]
        keypoints.append(_points(instance, file_names, columns))
        image = instance.data.get("image_id")
        name = images.get(image, image) if isinstance(image, int | str) else image
        names.append(f"{name} annotation {identity}")
    array = np.array(keypoints).reshape(-1, category.size, 2)
    return Annotations(category, array, tuple(names), source=f"{path.name} (COCO)")


def _layouts(
    path: Path, content: Fields, category: Category, rename: Mapping[str, str]
) -> dict[int, tuple[list[str], NDArray[np.intp]]]:
    layouts: dict[int, tuple[list[str], NDArray[np.intp]]] = {}
    refusal: InvalidInputError | None = None
    for number, entry in enumerate(content.get("categories", list)):
        fields = Fields(entry, f"{path}: categories[{number}].")
        if "keypoints" not in fields:
            continue
        names = [str(name) for name in fields.get("keypoints", list)]
        try:
            columns = in_category_order(f"{fields.where}keypoints", [rename.get(n, n) for n in names], category)
        except InvalidInputError as error:
            refusal = error
            continue
        layouts[fields.get("id", int)] = names, columns
    if not layouts:
        fix = "Give a COCO file whose categories list their keypoints."
        raise refusal or InvalidInputError(f"{path}: categories", "no keypoint names", fix)
    return layouts


def _points(instance: Fields, names: list[str], columns: NDArray[np.intp]) -> NDArray[np.float64]:
    values: list[Any] = instance.get("keypoints", list)
    if len(values) != 3 * len(names):
        fix = f"Give u, v and flag for each of {len(names)} keypoints ({3 * len(names)} numbers)."
        raise InvalidInputError(f"{instance.where}keypoints", f"{len(values)} numbers", fix)
    points = np.full((len(columns), 2), np.nan)
    for row, column in enumerate(columns):
        if column < 0:
            continue
        u, v, flag = values[3 * column : 3 * column + 3]
        where = f"{instance.where}{names[column]}"
        if isinstance(flag, bool) or flag not in (0, 1, 2):
            raise InvalidInputError(where, f"flag {flag!r}", "Give 0 (not labelled), 1 (hidden) or 2 (visible).")
        if flag:
            if not all(isinstance(x, int | float) and not isinstance(x, bool) and abs(x) < _LARGEST for x in (u, v)):
                raise InvalidInputError(where, [u, v], "Give finite pixels u, v.")
            points[row] = u, v
    return points
