"""Reader of PASCAL3D+ annotations: one MATLAB file per image, as the data set ships them."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.category import Category
from fgrecon.core.errors import InvalidInputError
from fgrecon.io.annotations.annotations import Annotations

__all__ = ["read_pascal3d"]

_VISIBLE = 1
"""Status of an anchor: 1 visible, 2 self-occluded, 3 occluded, 4 truncated, 5 unknown."""


def read_pascal3d(paths: list[Path], category: Category, rename: Mapping[str, str]) -> Annotations:
    """Annotations of PASCAL3D+ files: `record.objects(i).anchors.NAME` with `location` [x y] and `status`.

    Objects whose anchors have no name of the category (other classes, or objects without anchors) are passed over.
    Pixels become 0-based: MATLAB counts from 1.

    Args:
        paths: The `.mat` files, one per image.
        category: The category to read for; its keypoints bear the anchors' names.
        rename: From the anchors' names to the category's, where they differ.

    Returns:
        The annotations of the visible anchors.

    Raises:
        InvalidInputError: A file is no such file, or an anchor has no usable location; names file, object and anchor.
    """
    keypoints: list[NDArray[np.float64]] = []
    names: list[str] = []
    met: set[str] = set()
    for path in paths:
        for number, anchors in enumerate(_objects(path)):
            present = {name: rename.get(name, name) for name in anchors}
            met.update(anchors)
            if not any(target in category.keypoints for target in present.values()):
                continue
            points = np.full((category.size, 2), np.nan)
            for name, target in present.items():
                if target in category.keypoints:
                    where = f"{path}: object {number + 1}: {name}"
                    points[category.keypoints.index(target)] = _location(where, anchors[name])
            if np.isfinite(points).any():
                keypoints.append(points)
                names.append(f"{path.stem} object {number + 1}")
    if met and not met & ({*category.keypoints} | {name for name, to in rename.items() if to in category.keypoints}):
        fix = f"Use a category with these anchors' names, or rename them to: {', '.join(category.keypoints)}."
        raise InvalidInputError(f"{paths[0]}: anchors", ", ".join(sorted(met)), fix)
    array = np.array(keypoints).reshape(-1, category.size, 2)
    return Annotations(category, array, tuple(names), source=f"{len(paths)} PASCAL3D+ files")


def _objects(path: Path) -> list[dict[str, Any]]:
    """The anchors of each object of a file, by name; empty where an object has none."""
    import zlib

    from scipy.io import loadmat
    from scipy.io.matlab import MatReadError

    fix = "Give a file of PASCAL3D+'s Annotations folder (MATLAB 5 to 7.2 format)."
    try:
        record = loadmat(str(path), squeeze_me=True, struct_as_record=False)["record"]
        objects = np.atleast_1d(record.objects)
    except FileNotFoundError:
        raise InvalidInputError("annotations", str(path), "Give a file that exists.") from None
    except KeyError:
        raise InvalidInputError(f"{path}: record", "no such variable", fix) from None
    except AttributeError:
        raise InvalidInputError(f"{path}: record.objects", "no such field", fix) from None
    except (MatReadError, zlib.error, OSError, ValueError, TypeError, NotImplementedError) as error:
        raise InvalidInputError(str(path), f"not readable: {error}", fix) from error
    anchors = [getattr(item, "anchors", None) for item in objects]
    return [
        {name: getattr(group, name) for name in getattr(group, "_fieldnames", [])} if group is not None else {}
        for group in anchors
    ]


def _location(where: str, anchor: Any) -> NDArray[np.float64]:
    """(2,) 0-based pixels, NaN where the anchor is not visible."""
    status = getattr(anchor, "status", None)
    if status is None and not hasattr(anchor, "location"):
        raise InvalidInputError(where, repr(anchor), "Give an anchor with status and location.")
    location = np.asarray(getattr(anchor, "location", ()))
    if status is not None and (np.size(status) != 1 or int(np.ravel(status)[0]) != _VISIBLE):
        return np.full(2, np.nan)
    if location.size == 0 and status is None:
        return np.full(2, np.nan)
    if location.size != 2 or location.dtype.kind not in "iuf" or not np.isfinite(location).all():
        raise InvalidInputError(where, location.tolist(), "Give a visible anchor a location [x y].")
    return location.astype(np.float64).ravel() - 1.0
