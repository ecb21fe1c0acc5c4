"""nuScenes and TruckScenes: the scenes of their tables.

A box stands in the world: centre, `size` width, length, height, `rotation` w, x, y, z from axes forward, left, up. Key
frames show the boxes of their sample; sweeps between them are not labelled. nuScenes places the boxes by where the
vehicle was when the image was taken, TruckScenes by where it was when the sample was: each as its devkit does.
"""

from __future__ import annotations

from bisect import bisect_left
from collections import defaultdict
from dataclasses import replace
from pathlib import Path

import numpy as np

from fgrecon.core.arrays import Array
from fgrecon.core.camera import Camera
from fgrecon.core.checks import as_size
from fgrecon.io.datasets.description import CameraImage, DataSequence, Moment, Reader, Sweep, WorldBox
from fgrecon.io.json_fields import Fields, within
from fgrecon.io.nuscenes import NuScenesTables, is_nuscenes, open_nuscenes, pose_of

_NEEDED = "scene", "sample", "sample_annotation", "instance", "category"
_TRUCKSCENES = "ego_motion_chassis"
_SECONDS = 1e-6  # of a timestamp
_CARS = {"vehicle.car": "Car"}
_OCCLUSION = {"1": 2, "2": 1, "3": 1, "4": 0}
"""KITTI's grade by the token of visibility: 1 shows less than 40 %, 4 from 80 %."""


def _scenes(path: Path) -> dict[str, NuScenesTables]:
    """The tables by the names of the scenes."""
    folder = _tables(path)
    if folder is None:
        return {}
    tables = open_nuscenes(folder)
    return {scene.get("name", str): tables for scene in tables.table("scene").values()}


def _read(name: str, tables: NuScenesTables) -> DataSequence:
    """A scene."""
    scene = next(one for one in tables.table("scene").values() if one.get("name", str) == name)
    token = scene.get("token", str)
    samples = {t: s for t, s in tables.table("sample").items() if s.get("scene_token", str) == token}
    boxes, trucks = _boxes(tables, samples), (tables.folder / f"{_TRUCKSCENES}.json").is_file()
    poses = _Poses(tables) if trucks else None
    images: list[CameraImage] = []
    places: dict[str, Array] = {}
    sweeps: dict[str, Sweep] = {}
    for record in tables.table("sample_data").values():
        sample = record.get("sample_token", str)
        if sample not in samples:
            continue
        sensor = tables.named(record, "calibrated_sensor_token", "calibrated_sensor")
        channel = tables.named(sensor, "sensor_token", "sensor").get("channel", str)
        key = record.data.get("is_key_frame") is not False
        place = (
            pose_of(tables.named(record, "ego_pose_token", "ego_pose"))
            if poses is None or not key
            else poses.at(samples[sample].get("timestamp", int))
        )
        file = tables.folder.parent / record.get("filename", str)
        if sensor.data.get("camera_intrinsic"):
            images.append(_image(record, sensor, channel, file, place, sample if key else None))
        elif key and (
            channel.startswith("LIDAR") and (sample not in sweeps or channel < sweeps[sample].path.parent.name)
        ):
            sweeps[sample] = Sweep(file, place @ pose_of(sensor))
        if key and (sample not in places or channel.startswith("LIDAR")):
            places[sample] = place
    moments = {
        t: Moment(t, s.get("timestamp", int) * _SECONDS, places.get(t, np.eye(4)), tuple(boxes[t]))
        for t, s in samples.items()
    }
    shown = (replace(image, sweep=sweeps.get(image.moment or "")) for image in images)
    return DataSequence(name, tuple(shown), moments, _CARS)


def _image(
    record: Fields, sensor: Fields, channel: str, file: Path, world_T_vehicle: Array, moment: str | None
) -> CameraImage:
    size = record.get("width", int), record.get("height", int)
    with within(sensor.where):
        lens = Camera(sensor.numbers("camera_intrinsic", (3, 3)), image_size=size)
    return CameraImage(
        camera=channel,
        path=file,
        name=record.get("token", str),
        time=record.get("timestamp", int) * _SECONDS,
        lens=lens,
        vehicle_T_camera=pose_of(sensor),
        world_T_vehicle=world_T_vehicle,
        moment=moment,
    )


def _boxes(tables: NuScenesTables, samples: dict[str, Fields]) -> dict[str, list[WorldBox]]:
    """The boxes of each sample."""
    found: dict[str, list[WorldBox]] = defaultdict(list)
    for token, label in tables.table("sample_annotation").items():
        if (sample := label.get("sample_token", str)) not in samples:
            continue
        instance = tables.named(label, "instance_token", "instance")
        size = as_size(f"{label.where}size", label.numbers("size", (3,))[[1, 0, 2]])
        found[sample].append(
            WorldBox(
                name=token,
                kind=tables.named(instance, "category_token", "category").get("name", str),
                world_T_box=pose_of(label),
                size=size,
                track=instance.get("token", str),
                occlusion=_OCCLUSION.get(str(label.data.get("visibility_token")), -1),
            )
        )
    return found


class _Poses:
    """The vehicle's poses by time: TruckScenes takes the nearest one."""

    def __init__(self, tables: NuScenesTables) -> None:
        records = sorted(tables.table("ego_pose").values(), key=lambda record: record.get("timestamp", int))
        self._records, self._times = records, [record.get("timestamp", int) for record in records]

    def at(self, time: int) -> Array:
        """(4, 4) the pose nearest to a time; of two as near the earlier."""
        place = bisect_left(self._times, time)
        near = [i for i in (place - 1, place) if 0 <= i < len(self._times)]
        return pose_of(self._records[min(near, key=lambda i: (abs(self._times[i] - time), i))])


def _tables(path: Path) -> Path | None:
    """The folder of the tables."""
    inside = sorted(folder for folder in path.glob("v*") if is_nuscenes(folder))
    folder = path if is_nuscenes(path) else inside[0] if len(inside) == 1 else None
    return folder if folder is not None and all((folder / f"{n}.json").is_file() for n in _NEEDED) else None


READER = Reader("scene", _scenes, _read)
"""nuScenes' or TruckScenes' tables with labels, or the folder in which they are the only ones."""
