"""Boxes of a detector for a data set as 3D boxes that can be replaced: all else of their file stays as it was.

| file | boxes of | in the frame of |
|---|---|---|
| `.feather` with `timestamp_ns` | Argoverse 2 | the vehicle |
| `.json` with `results` by sample | nuScenes, TruckScenes | the world |
| `.json` with `results` by frame | ZOD | the vehicle |

Which image shows a box is in the data set: of several the one that has it most in the middle.
"""

from __future__ import annotations

import io
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.camera import MIN_DEPTH
from fgrecon.core.errors import InvalidInputError
from fgrecon.io.box_lines import BoxedImage
from fgrecon.io.datasets import CameraImage, DataSequence, Moment, open_sequence
from fgrecon.io.datasets.argoverse2 import PLACE, QUATERNION, SIZE
from fgrecon.io.datasets.columns import Columns, read_columns
from fgrecon.io.datasets.description import images_there
from fgrecon.io.json_fields import Fields
from fgrecon.io.nuscenes import pose_of
from fgrecon.io.nuscenes_detections import Submission, Submitted, SubmittedBox, nuscenes_fields, read_results

Array = NDArray[np.float64]


@dataclass(frozen=True)
class FeatherDetections:
    """Rows of a feather file, and the images that show them."""

    table: Columns
    images: Sequence[BoxedImage[SubmittedBox]]

    def content(self, changed: Mapping[int, Mapping[str, Any]]) -> bytes:
        """The file with other rows for some, by their numbers."""
        import pyarrow as pa
        from pyarrow import feather

        rows, sink = self.table.table.to_pylist(), io.BytesIO()
        rows = [changed.get(number, row) for number, row in enumerate(rows)]
        feather.write_feather(pa.Table.from_pylist(rows, self.table.table.schema), sink, compression="uncompressed")
        return sink.getvalue()


def read_detections(path: Path, source: str | Path) -> Submitted:
    """Boxes and the images of a data set that show them.

    Args:
        path: Of the kinds above.
        source: The data set with what is meant of it (`fgrecon.io.datasets`).

    Raises:
        InvalidInputError: A file cannot be read or is malformed, or has no box of these images; names file and field.
    """
    sequence, camera = open_sequence(source)
    images = images_there(sequence, sequence.images if camera is None else sequence.of_camera(camera))
    views: dict[str, list[CameraImage]] = defaultdict(list)
    for image in images:
        views[image.moment or ""].append(image)
    boxed: dict[Path, list[SubmittedBox]] = {image.path: [] for image in images if image.moment is not None}
    data, found = _in_feather(path, sequence) if path.suffix == ".feather" else _in_json(path, sequence)
    for moment, box in found:
        centre = box["world_T_object"][:3, 3]
        if (best := _best(views[moment.name], centre)) is not None:
            boxed[best.path].append(SubmittedBox(world_T_camera=best.world_T_camera, **box))
    if not any(boxed.values()):
        raise InvalidInputError("images", str(source), f"Give images that show boxes of {path}.")
    lenses = {image.path: image.lens for image in images}
    shown = [BoxedImage(file.stem, file, path, tuple(own), lenses[file]) for file, own in boxed.items()]
    return FeatherDetections(data, shown) if isinstance(data, Columns) else Submission(data, tuple(shown))


_Found = Iterator[tuple[Moment, dict[str, Any]]]


def _in_feather(path: Path, sequence: DataSequence) -> tuple[Columns, _Found]:
    table = read_columns(path)
    entries, poses, sizes = table.table.to_pylist(), table.poses(QUATERNION, PLACE), table.numbers(*SIZE)
    scores = table.numbers("score")[:, 0] if "score" in table.table.column_names else np.ones(len(table))

    def fields(centre: Array, size: Array, rotation: Array) -> dict[str, Any]:
        values = zip((PLACE, SIZE, QUATERNION), (centre, size, rotation), strict=True)
        return {name: value for names, row in values for name, value in zip(names, row.tolist(), strict=True)}

    def found() -> _Found:
        for number, (time, kind) in enumerate(zip(table.values("timestamp_ns"), table.values("category"), strict=True)):
            moment, entry = sequence.moments.get(str(time)), entries[number]
            if moment is not None and entry.get("log_id", sequence.name) == sequence.name:
                about = {"number": number, "place": {"row": number}, "entry": entry, "score": float(scores[number])}
                about |= {"kind": sequence.cars.get(kind, str(kind)), "size": sizes[number], "fields": fields}
                turn = np.array([entry[name] for name in QUATERNION])
                yield moment, _placed(about, turn, poses[number], moment.world_T_vehicle)

    return table, found()


def _in_json(path: Path, sequence: DataSequence) -> tuple[Mapping[str, Any], _Found]:
    data, results = read_results(path)

    def found() -> _Found:
        number = -1
        for token, entries in results.items():
            of_zod = f"frames/{token}" in sequence.moments
            moment = sequence.moments.get(f"frames/{token}" if of_zod else token)
            for index, entry in enumerate(entries):
                number += 1
                if moment is None:
                    continue
                row = Fields(entry, f"{path}: results.{token}[{index}].")
                kind, score = row.get("detection_name", str), float(row.numbers("detection_score", ()))
                about = {"number": number, "place": {"sample_token": token, "index": index}, "entry": entry}
                about |= {"kind": sequence.cars.get(kind, kind), "score": score, "fields": nuscenes_fields}
                about["size"] = row.numbers("size", (3,))[[1, 0, 2]]
                world_T_frame = moment.world_T_vehicle if of_zod else np.eye(4)
                yield moment, _placed(about, row.numbers("rotation", (4,)), pose_of(row), world_T_frame)

    return data, found()


def _placed(about: dict[str, Any], rotation: Array, frame_T_box: Array, world_T_frame: Array) -> dict[str, Any]:
    place = {"world_T_object": world_T_frame @ frame_T_box, "frame_T_world": np.linalg.inv(world_T_frame)}
    return {**about, "rotation": rotation, **place}


def _best(images: Sequence[CameraImage], centre: Array) -> CameraImage | None:
    """The image that has a point of the world most in its middle; None where it is in none."""
    inside = []
    for image in images:
        ((u, v),), (depth,) = image.pixels(centre[None])
        size = image.lens.image_size
        if depth > MIN_DEPTH and size is not None and 0.0 <= u <= size[0] and 0.0 <= v <= size[1]:
            inside.append((abs(u / size[0] - 0.5), image))
    return min(inside, key=lambda one: one[0])[1] if inside else None
