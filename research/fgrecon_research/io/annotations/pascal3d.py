"""Reader of PASCAL3D+ annotations: one MATLAB file per image, as the data set ships them."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.category import Category
from fgrecon.core.errors import InvalidInputError
from fgrecon.io.isolated import Isolated
from fgrecon.io.keypoints.pascal3d import AnchoredObject, read_anchors
from fgrecon_research.io.annotations.annotations import Annotations


def read_pascal3d(paths: list[Path], category: Category, rename: Mapping[str, str]) -> Annotations:
    """Annotations of PASCAL3D+ files: `record.objects(i).anchors.NAME` with `location` [x y] and `status`.

    Objects whose anchors have no name of the category (other classes, or objects without anchors) are passed over.
    Of the others the visible anchors are taken. Pixels become 0-based: MATLAB counts from 1.

    Args:
        rename: From the anchors' names to the category's, where they differ.

    Raises:
        InvalidInputError: A file is no such file, or an anchor has no usable location; names file, object and anchor.
    """
    keypoints: list[NDArray[np.float64]] = []
    names: list[str] = []
    met: set[str] = set()
    with Isolated() as child:
        objects = [(path, read_anchors(path, child)) for path in paths]
    for path, found in objects:
        for number, item in enumerate(found):
            present = {name: rename.get(name, name) for name in item.anchors}
            met.update(present)
            if not any(target in category.keypoints for target in present.values()):
                continue
            wanted = {name: item.anchors[name] for name, target in present.items() if target in category.keypoints}
            points = np.full((category.size, 2), np.nan)
            visible = AnchoredObject(wanted, None).visible(f"{path}: object {number + 1}: ")
            for name, pixel in visible.items():
                points[category.keypoints.index(present[name])] = pixel
            if np.isfinite(points).any():
                keypoints.append(points)
                names.append(f"{path.stem} object {number + 1}")
    if met and not met & ({*category.keypoints} | {name for name, to in rename.items() if to in category.keypoints}):
        fix = f"Use a category with these anchors' names, or rename them to: {', '.join(category.keypoints)}."
        raise InvalidInputError(f"{paths[0]}: anchors", ", ".join(sorted(met)), fix)
    array = np.array(keypoints).reshape(-1, category.size, 2)
    return Annotations(category, array, tuple(names), source=f"{len(paths)} PASCAL3D+ files")
