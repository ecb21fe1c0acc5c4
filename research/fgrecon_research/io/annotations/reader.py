"""One entry to all annotation formats: the format follows from the files' names."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np

from fgrecon.core.category import Category
from fgrecon.core.errors import InvalidInputError
from fgrecon_research.io.annotations.annotations import Annotations
from fgrecon_research.io.annotations.named import read_coco, read_pascal3d
from fgrecon_research.io.annotations.npz import read_npz
from fgrecon_research.io.annotations.veri36 import read_veri36

FORMATS = {".json": "COCO keypoints", ".mat": "PASCAL3D+", ".npz": "numpy", ".csv": "VeRi, 36 keypoints"}
"""What a file's suffix says about its format."""

_SINGLE: dict[str, Callable[[Path, Category, Mapping[str, str]], Annotations]] = {
    ".json": read_coco,
    ".npz": read_npz,
    ".csv": read_veri36,
}


def load_annotations(
    paths: Sequence[str | Path], category: Category, rename: Mapping[str, str] | None = None
) -> Annotations:
    """Read annotation files of any known format and put them together.

    Args:
        paths: Files (`.json` COCO, `.mat` PASCAL3D+, `.npz`, `.csv` VeRi with 36 keypoints), or folders, of which all
            such files are read in the order of their names.
        rename: From the files' keypoint names to the category's, where they differ.

    Raises:
        InvalidInputError: No file, an unknown format, nothing annotated, or what the format's reader refuses.
    """
    rename = rename or {}
    for target in rename.values():
        category.index(target)
    files = [file for path in paths for file in _files(Path(path))]
    if not files:
        raise InvalidInputError("annotations", [str(path) for path in paths], "Give at least one annotation file.")
    parts = []
    matlab = [file for file in files if file.suffix.lower() == ".mat"]
    if matlab:
        parts.append(read_pascal3d(matlab, category, rename))
    parts += [_SINGLE[file.suffix.lower()](file, category, rename) for file in files if file not in matlab]
    whole = _joined(parts)
    if not whole.measured.any():
        fix = f"Give annotations with keypoints of {category.name}: {', '.join(category.keypoints)}."
        raise InvalidInputError(str(files[0]), "no annotated keypoint", fix)
    return whole


def _files(path: Path) -> list[Path]:
    if path.is_dir():
        return sorted(file for file in path.iterdir() if file.suffix.lower() in FORMATS)
    if path.suffix.lower() not in FORMATS:
        known = ", ".join(f"{suffix} ({name})" for suffix, name in FORMATS.items())
        raise InvalidInputError("annotations", str(path), f"Give a file of a known format: {known}.")
    return [path]


def _joined(parts: list[Annotations]) -> Annotations:
    if len(parts) == 1:
        return parts[0]
    known_vehicles = [part.vehicles for part in parts if part.vehicles is not None]
    known_views = [part.views for part in parts if part.views is not None]
    return Annotations(
        parts[0].category,
        np.concatenate([part.keypoints for part in parts]),
        tuple(name for part in parts for name in part.names),
        np.concatenate(known_vehicles) if len(known_vehicles) == len(parts) else None,
        np.concatenate(known_views) if len(known_views) == len(parts) else None,
        ", ".join(part.source for part in parts),
    )
