"""Chooses the kind of file, by the ending of its name where that says enough."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

from fgrecon.core.errors import InvalidInputError
from fgrecon.io.export.annotation_files import (
    cvat_text,
    datumaro_text,
    fiftyone_text,
    label_studio_text,
    labelme_text,
    scalabel_text,
    supervisely_text,
)
from fgrecon.io.export.dataset_results import coco_results_text, kitti_poses_text, kitti_text, tum_text
from fgrecon.io.export.image_info import ImageInfo
from fgrecon.io.export.mcap import detections_bytes, ros2_bytes, scene_bytes
from fgrecon.io.export.mesh import glb_bytes, ply_bytes
from fgrecon.io.export.openlabel import openlabel_text
from fgrecon.io.export.results import NamedResult
from fgrecon.io.export.submissions import (
    argoverse2_bytes,
    cityscapes3d_text,
    nuscenes_text,
    nuscenes_tracking_text,
    truckscenes_text,
    waymo_bytes,
    zod_text,
)
from fgrecon.io.export.table import AddRows, csv_file, csv_text, parquet_bytes, parquet_file
from fgrecon.io.files import check_ending, write_bytes

Images = Mapping[str, ImageInfo]

_KINDS: dict[str, tuple[str, Callable[[Sequence[NamedResult], Images], str | bytes]]] = {
    "ply": ("ply", lambda results, _: ply_bytes(results)),
    "glb": ("glb", lambda results, _: glb_bytes(results)),
    "csv": ("csv", lambda results, _: csv_text(results)),
    "parquet": ("parquet", lambda results, _: parquet_bytes(results)),
    "kitti": ("txt", lambda results, _: kitti_text(results)),
    "tum": ("txt", lambda _, images: tum_text(images)),
    "kitti_poses": ("txt", lambda _, images: kitti_poses_text(images)),
    "nuscenes": ("json", nuscenes_text),
    "nuscenes_tracking": ("json", nuscenes_tracking_text),
    "truckscenes": ("json", truckscenes_text),
    "zod": ("json", zod_text),
    "coco": ("json", coco_results_text),
    "cityscapes3d": ("json", cityscapes3d_text),
    "openlabel": ("json", openlabel_text),
    "label_studio": ("json", label_studio_text),
    "scalabel": ("json", scalabel_text),
    "labelme": ("json", labelme_text),
    "supervisely": ("json", supervisely_text),
    "datumaro": ("json", datumaro_text),
    "fiftyone": ("json", fiftyone_text),
    "argoverse2": ("feather", argoverse2_bytes),
    "waymo": ("bin", waymo_bytes),
    "cvat": ("xml", cvat_text),
    "foxglove": ("mcap", scene_bytes),
    "vision_msgs": ("mcap", detections_bytes),
    "ros2": ("mcap", ros2_bytes),
}
"""Ending and writer of each kind."""

KINDS = tuple(_KINDS)
"""Kinds of files that `export` writes."""

FORMATS = tuple(dict.fromkeys(ending for ending, _ in _KINDS.values()))
"""The endings of their names."""

_REFUSED = {
    "kitti360": "Give another: KITTI-360 scores boxes of what stands still in clouds of many frames, not of images.",
    "pandaset": "Give another: PandaSet's results would be pickles, which run code.",
    "ddad": "Give another: DDAD has no evaluation of boxes.",
}
"""What is asked for and not written, with the reason."""

_PLAIN = {"txt": "kitti"}
"""What is meant by an ending alone that stands for several kinds."""

OF_FRAMES = frozenset(["tum", "kitti_poses"])
"""Kinds that are about the images alone: they need no vehicle."""

_TABLES: dict[str, Callable[[Path], AbstractContextManager[AddRows]]] = {"csv": csv_file, "parquet": parquet_file}

TABLE_FORMATS = tuple(_TABLES)
"""Those of them that are tables, which `export_rows` writes."""


def check_format(path: str | Path, kind: str | None = None) -> str:
    """The kind of file.

    Args:
        kind: One of `KINDS`, or None for what the ending says.

    Raises:
        InvalidInputError: Nothing is written with that ending, it stands for several kinds, or not for this one.
    """
    if kind in _REFUSED:
        raise InvalidInputError("format", kind, _REFUSED[kind])
    ending = check_ending(path, FORMATS)
    kinds, kind = [one for one in KINDS if _KINDS[one][0] == ending], kind or _PLAIN.get(ending)
    if kind is None and len(kinds) > 1:
        raise InvalidInputError("format", f"none for {Path(path).name}", f"Give {' or '.join(kinds)}.")
    if kind is not None and kind not in kinds:
        raise InvalidInputError("format", f"{kind} for {Path(path).name}", f"Give {' or '.join(kinds)}.")
    return kind or kinds[0]


def export(
    path: str | Path, results: Sequence[NamedResult], kind: str | None = None, images: Images | None = None
) -> Path:
    """Write results to a file, whole or not at all.

    Args:
        path: `.ply` or `.glb`: surfaces and wireframes in the camera frame; `.csv` or `.parquet`: one row per vehicle;
            `.txt`: KITTI's result lines of one image, or poses of the camera; `.json`: results for nuScenes, COCO or
            data sets, or labels for a tool; `.xml`: CVAT; `.feather`: Argoverse 2's detections; `.bin`: Waymo's;
            `.mcap`: Foxglove's or ROS 2's messages.
        results: Vehicles; those without a pose are left out, except in tables.
        kind: One of `KINDS`, where the ending stands for several.
        images: What is known of their images (`fgrecon.io.export.image_info`), for all but meshes, tables and KITTI.

    Returns:
        The path written to.

    Raises:
        InvalidInputError: Another ending, the file cannot be written, there is nothing to write, or something is not
            known of an image, or its time is none that the file can tell; KITTI's lines of several images.
        MissingPackageError: A package for MCAP is not installed.
    """
    check_ending(path, FORMATS)
    chosen = check_format(path, kind) if results or kind in OF_FRAMES else None
    if chosen is None:
        raise InvalidInputError("results", "none", "Give at least one reconstructed vehicle.")
    content = _KINDS[chosen][1](results, images or {})
    return write_bytes(path, content.encode() if isinstance(content, str) else content)


def export_rows(path: str | Path, rows: Sequence[Mapping[str, Any]]) -> Path:
    """Write rows with the same columns as a table, whole or not at all; `.csv` or `.parquet` by the ending."""
    with table_file(path) as add:
        if not rows:
            raise InvalidInputError("rows", "none", "Give at least one.")
        add(rows)
    return Path(path)


def table_file(path: str | Path) -> AbstractContextManager[AddRows]:
    """What adds rows to such a table, one at least; it is there when the context ends."""
    return _TABLES[check_ending(path, TABLE_FORMATS)](Path(path))
