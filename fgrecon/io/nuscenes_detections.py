"""nuScenes' submissions of its detection task as 3D boxes that can be replaced: all else stays as it was written.

A submission is `{"meta": ..., "results": {sample_token: [box, ...]}}`. A box stands in the world's frame: `translation`
of its centre, `size` width, length, height, `rotation` w, x, y, z from axes x forward, y left, z up. Which image shows
it is in the tables: the key frames of its sample. One that several cameras see is taken from the one that has it most
in the middle.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import numpy as np

from fgrecon.core.arrays import Array
from fgrecon.core.box3d import Box3D
from fgrecon.core.camera import MIN_DEPTH
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.geometry import transform
from fgrecon.core.reconstruction import rotation_y
from fgrecon.io.box_lines import BoxedImage, images_of
from fgrecon.io.json_fields import Fields, read_json
from fgrecon.io.nuscenes import NuScenesTables, pose_of

_FIX = "Give a submission of nuScenes' detection task: an object with `results`, a list of boxes by sample token."


@dataclass(frozen=True, eq=False)
class SubmittedBox:
    """A box of a submission in the image that shows it."""

    number: int  # of the box in its file, from 0
    kind: str  # its `detection_name`
    score: float  # its `detection_score`
    place: Mapping[str, str | int]  # what finds it in the file: sample and number within it, from 0
    entry: Mapping[str, Any]  # the box as it is written
    rotation: Array  # (4,) its quaternion there, w, x, y, z
    world_T_object: Array  # (4, 4) its centre and its axes forward, left, up
    size: Array  # (3,) length, width and height, metres
    world_T_camera: Array  # (4, 4) pose of the camera that took the image
    frame_T_world: Array  # (4, 4) into the frame in which it is written
    fields: Callable[[Array, Array, Array], dict[str, Any]]  # how centre, size and quaternion are written

    @property
    def corners(self) -> Array:
        """(4,) NaN: a submission has no 2D boxes."""
        return np.full(4, np.nan)

    def box(self, offset: Array) -> Box3D | None:
        """The 3D box in the camera's frame; None where it is not in front of the camera.

        Args:
            offset: (3,) where the boxes' frame lies from the camera's beside `world_T_camera`.
        """
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
        size = self.size if box.size is None else box.size
        up = self.world_T_object[:3, 2]
        place = transform(self.world_T_camera, box.location - offset) + up * size[2] / 2.0
        half = -0.5 * (box.rotation_y - before.rotation_y)  # the camera's y axis points down
        axis = self.frame_T_world[:3, :3] @ up
        turn = _product(np.array([np.cos(half), *(np.sin(half) * axis)]), self.rotation / np.linalg.norm(self.rotation))
        return {**self.entry, **self.fields(transform(self.frame_T_world, place), size, turn)}


def nuscenes_fields(centre: Array, size: Array, rotation: Array) -> dict[str, Any]:
    """How nuScenes, TruckScenes and ZOD write centre, length, width, height, and a quaternion w, x, y, z."""
    return {"translation": centre.tolist(), "size": size[[1, 0, 2]].tolist(), "rotation": rotation.tolist()}


class Submitted(Protocol):
    """Boxes of a file and the images that show them."""

    @property
    def images(self) -> Sequence[BoxedImage[SubmittedBox]]:
        """The images that are there, with the boxes that each shows."""

    def content(self, changed: Mapping[int, Mapping[str, Any]]) -> bytes:
        """The file with other entries for some boxes, by their numbers."""


@dataclass(frozen=True)
class Submission:
    """A submission and the images of its samples."""

    data: Mapping[str, Any]  # the file's content
    images: tuple[BoxedImage[SubmittedBox], ...]  # those of its samples that are there, with the boxes that each shows

    def content(self, changed: Mapping[int, Mapping[str, Any]]) -> bytes:
        """The JSON of the submission with other entries for some boxes, by their numbers."""
        number, results = 0, {}
        for token, entries in self.data["results"].items():
            results[token] = [changed.get(number + i, entry) for i, entry in enumerate(entries)]
            number += len(entries)
        return f"{json.dumps({**self.data, 'results': results})}\n".encode()


def is_submission(path: Path) -> bool:
    """Whether boxes are a submission's by the ending of their file."""
    return path.suffix.lower() in (".json", ".feather")


def read_submission(path: Path, images: Path, tables: NuScenesTables) -> Submission:
    """A submission and the images of its samples.

    Args:
        images: An image of a key frame, or a folder of such; they have nuScenes' names.

    Raises:
        InvalidInputError: A file cannot be read or is malformed, or there is none of the images; names file and field.
    """
    data, results = read_results(path)
    views = _views(images, tables)
    if not views.keys() & results.keys():
        fix = f"Give images of key frames that {tables.folder / 'sample_data.json'} has for the samples of {path}."
        raise InvalidInputError("images", str(images), fix)
    shown: dict[str, list[SubmittedBox]] = {v.name: [] for token in results for v in views.get(token, ())}
    files = {view.name: view.file for of_sample in views.values() for view in of_sample}
    number = 0
    for token, entries in results.items():
        for place, entry in enumerate(entries):
            fields = Fields(entry, f"{path}: results.{token}[{place}].")
            world_T_object, size = pose_of(fields), fields.numbers("size", (3,))[[1, 0, 2]]
            view = _best_view(views.get(token, ()), world_T_object[:3, 3])
            if view is not None:
                shown[view.name].append(
                    SubmittedBox(
                        number=number,
                        kind=fields.get("detection_name", str),
                        score=float(fields.numbers("detection_score", ())),
                        place={"sample_token": token, "index": place},
                        entry=entry,
                        rotation=fields.numbers("rotation", (4,)),
                        world_T_object=world_T_object,
                        size=size,
                        world_T_camera=view.world_T_camera,
                        frame_T_world=np.eye(4),
                        fields=nuscenes_fields,
                    )
                )
            number += 1
    return Submission(data, tuple(BoxedImage(name, files[name], path, tuple(own)) for name, own in shown.items()))


def read_results(path: Path) -> tuple[Mapping[str, Any], Mapping[str, list[Any]]]:
    """The content of a submission, and its entries by sample."""
    data = read_json(path)
    results = data.get("results") if isinstance(data, Mapping) else None
    if not isinstance(results, Mapping) or not all(isinstance(entries, list) for entries in results.values()):
        raise InvalidInputError(str(path), type(data).__name__, _FIX)
    return data, results


class PlacedBox(NamedTuple):
    """A box of a submission: kind, score, track or None, (4, 4) centre and axes forward, left, up, and (3,) size."""

    kind: str
    score: float
    track: str | None
    world_T_box: Array
    size: Array


def read_boxes_by_sample(path: Path) -> dict[str, list[PlacedBox]]:
    """The boxes of a submission of the detection or the tracking task, by sample.

    Raises:
        InvalidInputError: It cannot be read or is none, or a box is malformed; names file and field.
    """
    return {
        token: [_placed(Fields(entry, f"{path}: results.{token}[{n}].")) for n, entry in enumerate(entries)]
        for token, entries in read_results(path)[1].items()
    }


def _placed(fields: Fields) -> PlacedBox:
    task = "tracking" if "tracking_name" in fields else "detection"
    track = fields.get("tracking_id", str) if task == "tracking" else None
    kind, score = fields.get(f"{task}_name", str), float(fields.numbers(f"{task}_score", ()))
    size = fields.numbers("size", (3,))[[1, 0, 2]]
    if not (size > 0.0).all():
        raise InvalidInputError(f"{fields.where}size", size.tolist(), "Give width, length and height in metres.")
    return PlacedBox(kind, score, track, pose_of(fields), size)


@dataclass(frozen=True)
class _View:
    """A key frame of a camera: name and file of the image, its intrinsics (3, 3) and size, and the camera's pose."""

    name: str
    file: Path
    matrix: Array
    size: tuple[int, int]
    world_T_camera: Array


def _views(images: Path, tables: NuScenesTables) -> dict[str, list[_View]]:
    """The key frames whose images are there, by sample."""
    by_name, found = images_of(images), dict[str, list[_View]]()
    for record in tables.table("sample_data").values():
        name = Path(record.get("filename", str)).stem
        if name not in by_name or record.data.get("is_key_frame") is False:
            continue
        sensor = tables.named(record, "calibrated_sensor_token", "calibrated_sensor")
        pose = pose_of(tables.named(record, "ego_pose_token", "ego_pose")) @ pose_of(sensor)
        size = record.get("width", int), record.get("height", int)
        view = _View(name, by_name[name], sensor.numbers("camera_intrinsic", (3, 3)), size, pose)
        found.setdefault(record.get("sample_token", str), []).append(view)
    return found


def _best_view(views: list[_View] | tuple[()], centre: Array) -> _View | None:
    """The image that has a point of the world most in its middle; None where it is in none."""
    best, least = None, np.inf
    for view in views:
        x, y, z = view.world_T_camera[:3, :3].T @ (centre - view.world_T_camera[:3, 3])
        if z <= MIN_DEPTH:
            continue
        u, v, _ = view.matrix @ [x / z, y / z, 1.0]
        aside = abs(u / view.size[0] - 0.5)
        if aside <= min(least, 0.5) and 0.0 <= v <= view.size[1]:
            best, least = view, aside
    return best


def _product(first: Array, second: Array) -> Array:
    """The quaternion w, x, y, z of a rotation after another."""
    a, u, b, v = first[0], first[1:], second[0], second[1:]
    return np.array([a * b - u @ v, *(a * v + b * u + np.cross(u, v))])
