"""Reader of annotations in a numpy archive."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.category import Category
from fgrecon.core.errors import InvalidInputError
from fgrecon.io.arrays import read_arrays
from fgrecon_research.io.annotations.annotations import Annotations

_KEYPOINTS = ("keypoints_uv", "keypoints")
_VEHICLES = ("vehicle_id", "vehicles")
_VIEWS = ("orientation", "views")
_NAMES = ("image", "names")


def read_npz(path: Path, category: Category, rename: Mapping[str, str]) -> Annotations:
    """Annotations of an npz file without pickled content.

    Arrays: `keypoints_uv` or `keypoints` (M, K, 2), NaN where not marked, or (M, K, 3) with a third number that is
    above 0 where marked; optionally `keypoint_names` (K,), without which the order is the category's; `vehicle_id`
    or `vehicles` (M,); `orientation` or `views` (M,); `image` or `names` (M,).

    Args:
        rename: From the file's keypoint names to the category's, where they differ.

    Raises:
        InvalidInputError: Not such a file, or a wrong value; names file, instance and keypoint.
    """
    arrays = _arrays(path)
    key = next((key for key in _KEYPOINTS if key in arrays), None)
    if key is None:
        raise InvalidInputError(f"{path}: keypoints", ", ".join(arrays), "Give an array keypoints (M, K, 2).")
    points = arrays[key]
    if points.ndim != 3 or points.shape[2] not in (2, 3) or points.dtype.kind not in "iuf":
        raise InvalidInputError(f"{path}: {key}", f"{points.dtype} {points.shape}", "Give numbers (M, K, 2).")
    columns = _columns(path, arrays, points.shape[1], category, rename)
    values = points.astype(np.float64)
    if values.shape[2] == 3:
        marked = values[:, :, 2] > 0
        values = np.where(marked[:, :, None], values[:, :, :2], np.nan)
    ordered = np.where((columns >= 0)[:, None], values[:, columns], np.nan)

    def labels(keys: tuple[str, ...]) -> NDArray[Any] | None:
        field = next((key for key in keys if key in arrays), None)
        if field is None:
            return None
        if arrays[field].shape != (len(values),):
            fix = f"Give one for each of {len(values)} instances."
            raise InvalidInputError(f"{path}: {field}", f"shape {arrays[field].shape}", fix)
        return arrays[field]

    images = labels(_NAMES)
    kept = [f"{path}: instance {i}" + ("" if images is None else f" ({images[i]})") for i in range(len(values))]
    return Annotations(category, ordered, tuple(kept), labels(_VEHICLES), labels(_VIEWS), f"{path.name} (npz)")


def _arrays(path: Path) -> dict[str, NDArray[Any]]:
    fix = "Give an npz file without pickled content."
    try:
        return read_arrays(path, str(path), fix)
    except FileNotFoundError:
        raise InvalidInputError("annotations", str(path), "Give a file that exists.") from None


def _columns(
    path: Path, arrays: Mapping[str, NDArray[Any]], size: int, category: Category, rename: Mapping[str, str]
) -> NDArray[np.intp]:
    if "keypoint_names" in arrays:
        names = [str(name) for name in np.ravel(arrays["keypoint_names"])]
        if len(names) != size:
            raise InvalidInputError(f"{path}: keypoint_names", f"{len(names)} names", f"Give {size}.")
        ours = [rename.get(name, name) for name in names]
        if not set(ours) & set(category.keypoints):
            fix = f"Use the keypoint names of {category.name}, or rename: {', '.join(category.keypoints)}."
            raise InvalidInputError(f"{path}: keypoint_names", ", ".join(names), fix)
        return np.array([ours.index(name) if name in ours else -1 for name in category.keypoints])
    if size != category.size:
        fix = f"Give the {category.size} keypoints of {category.name} in its order, or an array keypoint_names."
        raise InvalidInputError(f"{path}: keypoints", f"{size} keypoints without names", fix)
    return np.arange(size)
