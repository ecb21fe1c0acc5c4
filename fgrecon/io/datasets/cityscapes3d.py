"""Cityscapes 3D: images with boxes in the frame of the vehicle, each image by itself.

A box has its centre, length, width, height, and a quaternion w, x, y, z from axes forward, left, up.
`sensor_T_ISO_8855` takes the vehicle's frame to the camera's place with the same axes; a camera looks along the first
of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from fgrecon.core.arrays import Array
from fgrecon.core.camera import Camera
from fgrecon.core.checks import as_quaternion, as_size
from fgrecon.core.geometry import AHEAD, quaternion_pose
from fgrecon.io.datasets.description import CameraImage, DataSequence, Moment, Reader, WorldBox
from fgrecon.io.json_fields import Fields, read_fields, within

_LABELS, _ENDING = "gtBbox3d", "_gtBbox3d.json"
_IMAGES, _IMAGE_ENDING = "leftImg8bit", "_leftImg8bit.png"
CAMERA = "left"
_CARS = {"car": "Car"}
_PARTLY, _LARGELY = 0.1, 0.5  # shares of occlusion from which KITTI's grade is 1 and 2; not tuned


def _read(name: str, files: Sequence[Path]) -> DataSequence:
    """The images of a city."""
    images, moments = [], {}
    for number, file in enumerate(files):
        stem = file.name.removesuffix(_ENDING)
        fields = read_fields(file)
        sensor = fields.inner("sensor")
        there = np.vstack([sensor.numbers("sensor_T_ISO_8855", (3, 4)), [0.0, 0.0, 0.0, 1.0]])
        vehicle_T_camera = np.linalg.inv(there)
        vehicle_T_camera[:3, :3] = vehicle_T_camera[:3, :3] @ AHEAD
        boxes = tuple(_box(entry, f"{stem}-{i}") for i, entry in enumerate(fields.each("objects")))
        moments[stem] = Moment(stem, float(number), np.eye(4), boxes)
        size = fields.get("imgWidth", int), fields.get("imgHeight", int)
        images.append(
            CameraImage(
                camera=CAMERA,
                path=_image(file, stem),
                name=stem,
                time=float(number),
                lens=_lens(sensor, size),
                vehicle_T_camera=vehicle_T_camera,
                world_T_vehicle=np.eye(4),
                moment=stem,
            )
        )
    return DataSequence(name, tuple(images), moments, _CARS, continuous=False)


def _lens(sensor: Fields, size: tuple[int, int]) -> Camera:
    fx, fy, u0, v0 = (float(sensor.numbers(name, ())) for name in ("fx", "fy", "u0", "v0"))
    with within(sensor.where):
        return Camera(np.array([[fx, 0.0, u0], [0.0, fy, v0], [0.0, 0.0, 1.0]]), image_size=size)


def _box(fields: Fields, name: str) -> WorldBox:
    box = fields.inner("3d")
    quaternion = as_quaternion(f"{box.where}rotation", box.numbers("rotation", (4,)))
    size = as_size(f"{box.where}dimensions", box.numbers("dimensions", (3,)))
    hidden = float(fields.numbers("occlusion", ())) if "occlusion" in fields else np.nan
    drawn = fields.inner("2d", needed=False)
    boxes = {CAMERA: _corners(drawn)} if "amodal" in drawn else {}
    return WorldBox(
        name=name,
        kind=fields.get("label", str),
        world_T_box=quaternion_pose(quaternion, box.numbers("center", (3,))),
        size=size,
        track=None,
        score=float(fields.numbers("score", ())) if fields.data.get("score") not in (None, 1.0, 1) else None,
        occlusion=-1 if np.isnan(hidden) else int(hidden >= _PARTLY) + int(hidden >= _LARGELY),
        boxes=boxes,
    )


def _corners(drawn: Fields) -> Array:
    """The corners of a box x, y, width, height."""
    x, y, width, height = drawn.numbers("amodal", (4,))
    return np.array([x, y, x + width, y + height])


def _image(file: Path, stem: str) -> Path:
    """The image of a file of labels, in Cityscapes' folders or beside it."""
    folders = list(file.parent.parts)
    if _LABELS in folders:
        folders[len(folders) - 1 - folders[::-1].index(_LABELS)] = _IMAGES
    return Path(*folders) / f"{stem}{_IMAGE_ENDING}"


def _files(path: Path) -> dict[str, list[Path]]:
    """The files of labels by city."""
    for pattern in (f"{_LABELS}/*/*/*{_ENDING}", f"*/*/*{_ENDING}", f"*/*{_ENDING}", f"*{_ENDING}"):
        found = sorted(path.glob(pattern))
        if found:
            cities: dict[str, list[Path]] = {}
            for file in found:
                cities.setdefault(file.name.split("_")[0], []).append(file)
            return cities
    return {}


READER = Reader("city", _files, _read)
"""Cityscapes: its folder with 3D boxes, or one of such files; a sequence is a city."""
