"""Boxes of a detector for a data set as 3D boxes that can be replaced: all else of their file stays as it was.

| file | boxes of | in the frame of |
|---|---|---|
| `.json` with `results` by sample | nuScenes, TruckScenes | the world |
| `.json` with `results` by frame | ZOD | the vehicle |
| `.feather` with `timestamp_ns` | Argoverse 2 | the vehicle |

A box has its centre, its size (width, length, height in JSON) and a quaternion w, x, y, z from axes forward, left, up.
Which image shows it is in the data set: of several the one that has it most in the middle.
"""

from __future__ import annotations

import io
import json
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from fgrecon.core.arrays import Array
from fgrecon.core.box3d import Box3D
from fgrecon.core.camera import MIN_DEPTH, Camera
from fgrecon.core.checks import as_size
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.geometry import transform
from fgrecon.core.reconstruction import rotation_y
from fgrecon.io.box_lines import BoxedImage, images_of
from fgrecon.io.datasets.argoverse2 import PLACE, QUATERNION, SIZE
from fgrecon.io.datasets.columns import read_columns
from fgrecon.io.datasets.description import CameraImage, DataSequence, WorldBox, images_there
from fgrecon.io.json_fields import Fields, read_json
from fgrecon.io.nuscenes import NuScenesTables, pose_of

_FIX = "Give a submission of nuScenes' detection task: an object with `results`, a list of boxes by sample token."


@dataclass(frozen=True, eq=False)
class DetectedBox:
    """A box of a file."""

    number: int  # of the box in its file, from 0
    kind: str  # its class
    score: float
    place: Mapping[str, str | int]  # what finds it in the file
    entry: Mapping[str, Any]  # the box as it is written
    world_T_object: Array  # (4, 4) its centre and its axes forward, left, up
    size: Array  # (3,) length, width and height, metres
    rotation: Array  # (4,) its quaternion as it is written
    frame_T_world: Array  # (4, 4) into the frame in which it is written
    written: Callable[[Array, Array, Array], dict[str, Any]]  # how centre, size and quaternion are
    world_T_camera: Array | None = None  # (4, 4) pose of the camera that took the image which shows it
    track: str | None = None

    @property
    def corners(self) -> Array:
        """(4,) NaN: there are no 2D boxes."""
        return np.full(4, np.nan)

    def box(self, offset: Array) -> Box3D | None:
        """The 3D box in the camera's frame; None where it is not in front of the camera.

        Args:
            offset: (3,) where the boxes' frame lies from the camera's beside `world_T_camera`.
        """
        assert self.world_T_camera is not None
        pose = np.linalg.inv(self.world_T_camera) @ self.world_T_object
        bottom = pose[:3, 3] - pose[:3, 2] * self.size[2] / 2.0
        try:
            return Box3D(bottom + offset, rotation_y(pose), self.size)
        except InvalidInputError:
            return None

    def with_box(self, box: Box3D, offset: Array) -> dict[str, Any]:
        """The entry with another 3D box in the camera's frame, turned about the axis that the box had for up."""
        before = self.box(offset)
        assert before is not None
        assert self.world_T_camera is not None
        size = self.size if box.size is None else box.size
        up = self.world_T_object[:3, 2]
        place = transform(self.world_T_camera, box.location - offset) + up * size[2] / 2.0
        half = -0.5 * (box.rotation_y - before.rotation_y)  # the camera's y axis points down
        turn = np.array([np.cos(half), *(np.sin(half) * (self.frame_T_world[:3, :3] @ up))])
        rotation = _product(turn, self.rotation / np.linalg.norm(self.rotation))
        return {**self.entry, **self.written(transform(self.frame_T_world, place), size, rotation)}


@dataclass(frozen=True)
class Detections:
    """The boxes of a file, and the images that show them."""

    images: tuple[BoxedImage[DetectedBox], ...]  # those that are there, with the boxes that each shows
    content: Callable[[Mapping[int, Mapping[str, Any]]], bytes]  # the file with others for some, by their numbers


def is_submission(path: Path) -> bool:
    """Whether boxes are of a data set by the ending of their file."""
    return path.suffix.lower() in (".json", ".feather")


def read_detections(path: Path, drive: DataSequence, camera: str | None) -> Detections:
    """Boxes and the images of a drive, or of a camera of it, that show them.

    Raises:
        InvalidInputError: A file cannot be read or is malformed, or has no box of these images; names file and field.
    """
    images = images_there(drive, drive.images if camera is None else drive.of_camera(camera))
    boxes, content = _of_feather(path, drive) if path.suffix == ".feather" else _of_json(path, drive)
    found = _shown(boxes, [image for image in images if image.moment is not None], path)
    if not any(image.objects for image in found):
        raise InvalidInputError("images", drive.name, f"Give images that show boxes of {path}.")
    return Detections(found, content)


def read_submission(path: Path, images: Path, tables: NuScenesTables) -> Detections:
    """A submission of nuScenes and the images of its samples, of whatever scenes.

    Args:
        images: An image of a key frame, or a folder of such; they have nuScenes' names.
        tables: Without scenes and labels as well.

    Raises:
        InvalidInputError: A file cannot be read or is malformed, or there is none of the images; names file and field.
    """
    boxes, content = _of_json(path, None)
    read = list(boxes)
    samples = {moment for moment, _ in read}
    shown = [image for image in _key_frames(images, tables) if image.moment in samples]
    if not shown:
        fix = f"Give images of key frames that {tables.folder / 'sample_data.json'} has for the samples of {path}."
        raise InvalidInputError("images", str(images), fix)
    found = _shown(iter(read), shown, path)
    return Detections(tuple(replace(image, camera=None) for image in found), content)


def with_submitted(path: Path, drive: DataSequence) -> DataSequence:
    """A scene of nuScenes with the boxes of a submission of the detection or the tracking task in place of its labels.

    Args:
        path: The submission; samples that it does not have are not labelled.

    Raises:
        InvalidInputError: It cannot be read, is none, a box is malformed, or it has none of the scene's samples.
    """
    _, results = _results(path)
    found: dict[str, list[WorldBox]] = {token: [] for token in results if token in drive.moments}
    for token, box in _boxes_of(path, results, drive):
        name = f"{token}/{len(found[token])}"
        found[token].append(WorldBox(name, box.kind, box.world_T_object, box.size, box.track, score=box.score))
    if not found:
        raise InvalidInputError("results", str(path), f"Give boxes of the samples of {drive.name}.")
    moments = {token: replace(drive.moments[token], boxes=tuple(boxes)) for token, boxes in found.items()}
    images = tuple(replace(one, moment=one.moment if one.moment in moments else None) for one in drive.images)
    return replace(drive, images=images, moments=moments, cars={"car": "Car"})


_Boxes = Iterator[tuple[str, DetectedBox]]
_Read = tuple[_Boxes, Callable[[Mapping[int, Mapping[str, Any]]], bytes]]


def _of_feather(path: Path, drive: DataSequence) -> _Read:
    """The boxes of a log of Argoverse 2, by their moments."""
    table = read_columns(path)
    entries, poses, sizes = table.table.to_pylist(), table.poses(QUATERNION, PLACE), table.numbers(*SIZE)
    scores = table.numbers("score")[:, 0] if "score" in table.table.column_names else np.ones(len(table))

    def written(centre: Array, size: Array, rotation: Array) -> dict[str, Any]:
        values = zip((*PLACE, *SIZE, *QUATERNION), np.concatenate([centre, size, rotation]).tolist(), strict=True)
        return dict(values)

    def content(changed: Mapping[int, Mapping[str, Any]]) -> bytes:
        import pyarrow as pa
        from pyarrow import feather

        rows, sink = [changed.get(number, row) for number, row in enumerate(entries)], io.BytesIO()
        feather.write_feather(pa.Table.from_pylist(rows, table.table.schema), sink, compression="uncompressed")
        return sink.getvalue()

    def boxes() -> _Boxes:
        for number, (time, kind) in enumerate(zip(table.values("timestamp_ns"), table.values("category"), strict=True)):
            moment, entry = drive.moments.get(str(time)), entries[number]
            if moment is not None and entry.get("log_id", drive.name) == drive.name:
                yield (
                    moment.name,
                    DetectedBox(
                        number=number,
                        kind=drive.cars.get(str(kind), str(kind)),
                        score=float(scores[number]),
                        place={"row": number},
                        entry=entry,
                        world_T_object=moment.world_T_vehicle @ poses[number],
                        size=sizes[number],
                        rotation=np.array([entry[name] for name in QUATERNION]),
                        frame_T_world=np.linalg.inv(moment.world_T_vehicle).astype(np.float64),
                        written=written,
                    ),
                )

    return boxes(), content


def _of_json(path: Path, drive: DataSequence | None) -> _Read:
    """The boxes of samples or of ZOD's frames: those of a drive, or all."""
    data, results = _results(path)

    def content(changed: Mapping[int, Mapping[str, Any]]) -> bytes:
        number, after = 0, {}
        for token, entries in results.items():
            after[token] = [changed.get(number + i, entry) for i, entry in enumerate(entries)]
            number += len(entries)
        return f"{json.dumps({**data, 'results': after})}\n".encode()

    return _boxes_of(path, results, drive), content


def _boxes_of(path: Path, results: Mapping[str, list[Any]], drive: DataSequence | None) -> _Boxes:
    """The boxes of entries by sample or frame: those of a drive, or all."""
    number = -1
    for token, entries in results.items():
        of_zod = drive is not None and f"frames/{token}" in drive.moments
        name, world_T_frame = f"frames/{token}" if of_zod else token, np.eye(4)
        if drive is not None and of_zod:
            world_T_frame = drive.moments[name].world_T_vehicle
        for index, entry in enumerate(entries):
            number += 1
            if drive is None or name in drive.moments:
                fields = Fields(entry, f"{path}: results.{token}[{index}].")
                found = _of_entry(fields, number, {"sample_token": token, "index": index}, world_T_frame)
                yield name, found if drive is None else replace(found, kind=drive.cars.get(found.kind, found.kind))


def _of_entry(fields: Fields, number: int, place: Mapping[str, str | int], world_T_frame: Array) -> DetectedBox:
    task = "tracking" if "tracking_name" in fields else "detection"
    return DetectedBox(
        number=number,
        kind=fields.get(f"{task}_name", str),
        score=float(fields.numbers(f"{task}_score", ())),
        place=place,
        entry=fields.data,
        world_T_object=world_T_frame @ pose_of(fields),
        size=as_size(f"{fields.where}size", fields.numbers("size", (3,))[[1, 0, 2]]),
        rotation=fields.numbers("rotation", (4,)),
        frame_T_world=np.linalg.inv(world_T_frame).astype(np.float64),
        written=_nuscenes_fields,
        track=fields.get("tracking_id", str) if task == "tracking" else None,
    )


def _nuscenes_fields(centre: Array, size: Array, rotation: Array) -> dict[str, Any]:
    return {"translation": centre.tolist(), "size": size[[1, 0, 2]].tolist(), "rotation": rotation.tolist()}


def _results(path: Path) -> tuple[Mapping[str, Any], Mapping[str, list[Any]]]:
    """The content of a submission, and its entries by sample."""
    data = read_json(path)
    results = data.get("results") if isinstance(data, Mapping) else None
    if not isinstance(results, Mapping) or not all(isinstance(entries, list) for entries in results.values()):
        raise InvalidInputError(str(path), type(data).__name__, _FIX)
    return data, results


def _key_frames(images: Path, tables: NuScenesTables) -> Iterator[CameraImage]:
    """The key frames whose images are there."""
    by_name = images_of(images)
    for record in tables.table("sample_data").values():
        name = Path(record.get("filename", str)).stem
        if name in by_name and record.data.get("is_key_frame") is not False:
            sensor = tables.named(record, "calibrated_sensor_token", "calibrated_sensor")
            size = record.get("width", int), record.get("height", int)
            yield CameraImage(
                camera="",
                path=by_name[name],
                name=name,
                time=0.0,
                lens=Camera(sensor.numbers("camera_intrinsic", (3, 3)), image_size=size),
                vehicle_T_camera=pose_of(sensor),
                world_T_vehicle=pose_of(tables.named(record, "ego_pose_token", "ego_pose")),
                moment=record.get("sample_token", str),
            )


def _shown(boxes: _Boxes, images: Sequence[CameraImage], source: Path) -> tuple[BoxedImage[DetectedBox], ...]:
    """The images with the boxes that each shows best."""
    views: dict[str | None, list[CameraImage]] = defaultdict(list)
    for image in images:
        views[image.moment].append(image)
    found: dict[Path, list[DetectedBox]] = {image.path: [] for image in images}
    for moment, box in boxes:
        if (best := _best(views[moment], box.world_T_object[:3, 3])) is not None:
            found[best.path].append(replace(box, world_T_camera=best.world_T_camera))
    return tuple(BoxedImage(i.path.stem, i.path, source, tuple(found[i.path]), i.lens) for i in images)


def _best(images: Sequence[CameraImage], centre: Array) -> CameraImage | None:
    """The image that has a point of the world most in its middle; None where it is in none."""
    inside = []
    for image in images:
        ((u, v),), (depth,) = image.pixels(centre[None])
        size = image.lens.image_size
        if depth > MIN_DEPTH and size is not None and 0.0 <= u <= size[0] and 0.0 <= v <= size[1]:
            inside.append((abs(u / size[0] - 0.5), image))
    return min(inside, key=lambda one: one[0])[1] if inside else None


def _product(first: Array, second: Array) -> Array:
    """The quaternion w, x, y, z of a rotation after another."""
    a, u, b, v = first[0], first[1:], second[0], second[1:]
    return np.array([a * b - u @ v, *(a * v + b * u + np.cross(u, v))])
