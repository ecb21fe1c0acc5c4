"""Readers of annotations that name each keypoint: COCO's JSON, and PASCAL3D+'s MATLAB files, one for each image."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np

from fgrecon.core.category import Category
from fgrecon.core.errors import InvalidInputError
from fgrecon.io.isolated import Isolated
from fgrecon.io.json_fields import read_json
from fgrecon.io.keypoints.coco_records import NOTHING_LABELLED, annotation_records
from fgrecon.io.keypoints.records import read_anchors
from fgrecon_research.io.annotations.annotations import Annotations

_Named = Iterable[tuple[str, Mapping[str, Sequence[float]]]]
"""Instances: what messages call each, and its keypoints by name."""


def read_coco(path: Path, category: Category, rename: Mapping[str, str]) -> Annotations:
    """Annotations of one COCO file, as `fgrecon reconstruct` reads it; whatever is labelled is used, hidden or not.

    Crowd regions and instances without a labelled keypoint of the category are left out.

    Args:
        rename: From the file's keypoint names to the category's, where they differ.

    Raises:
        InvalidInputError: Not such a file, or a wrong value; names file and annotation.
    """

    def instances() -> _Named:
        for record, _ in annotation_records(read_json(path), f"{path}: "):
            if not isinstance(record, InvalidInputError):
                yield f"{record.get('image', 'image unknown')} annotation {record['id']}", record["keypoints"]
            elif record.fix != NOTHING_LABELLED:
                raise record

    return _in_order(instances(), category, rename, f"{path.name} (COCO)", f"{path}: categories")


def read_pascal3d(paths: list[Path], category: Category, rename: Mapping[str, str]) -> Annotations:
    """The visible anchors of PASCAL3D+ files; pixels become 0-based: MATLAB counts from 1.

    Objects without an anchor of a name of the category, such as other classes, are passed over.

    Args:
        rename: From the anchors' names to the category's, where they differ.

    Raises:
        InvalidInputError: A file is no such file, or an anchor has no usable location; names file, object and anchor.
    """

    def instances() -> _Named:
        with Isolated() as child:
            for path in paths:
                for number, item in enumerate(read_anchors(path, child), start=1):
                    yield f"{path.stem} object {number}", item.visible(f"{path}: object {number}: ")

    return _in_order(instances(), category, rename, f"{len(paths)} PASCAL3D+ files", f"{paths[0]}: anchors")


def _in_order(instances: _Named, category: Category, rename: Mapping[str, str], source: str, where: str) -> Annotations:
    """The instances that have a keypoint of the category; an error where none has any, which blames a field."""
    keypoints, names, met = [], [], set[str]()
    for name, found in instances:
        points = np.full((category.size, 2), np.nan)
        for theirs, point in found.items():
            met.add(theirs)
            if (ours := rename.get(theirs, theirs)) in category.keypoints:
                points[category.index(ours)] = point[:2]
        if np.isfinite(points).any():
            keypoints.append(points)
            names.append(name)
    if met and not keypoints:
        fix = f"Use a category with these names, or rename them to: {', '.join(category.keypoints)}."
        raise InvalidInputError(where, ", ".join(sorted(met)), fix)
    return Annotations(category, np.array(keypoints).reshape(-1, category.size, 2), tuple(names), source=source)
