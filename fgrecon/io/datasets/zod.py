"""Zenseact Open Dataset (ZOD): its frames, sequences and drives, with the boxes of the key frame of each.

A box stands in the LiDAR's frame at the time of the key frame: its centre, length, width, height, and a quaternion
w, x, y, z from axes forward, left, up. `extrinsics` are poses in the vehicle's frame; the camera's are right, down,
forward. It is a fisheye (Kannala-Brandt), whose image is anonymised in two ways: `front_blur` and `front_dnat`.
"""

from __future__ import annotations

from collections.abc import Mapping
from datetime import UTC, datetime
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from fgrecon.core.arrays import Array
from fgrecon.core.camera import Camera
from fgrecon.core.checks import as_quaternion, as_rigid, as_size
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.geometry import box_around, quaternion_pose
from fgrecon.io.datasets.description import CameraImage, DataSequence, Moment, Reader, Sweep, WorldBox
from fgrecon.io.json_fields import Fields, numbers, read_fields, read_records, within
from fgrecon.io.poses import CameraPoses

_LISTS = "trainval-*-*.json"  # of frames, sequences and drives; full or mini
_FOLDERS = "single_frames", "sequences", "drives"
_LIDAR = "velodyne"
_FARTHEST = 0.06  # seconds from an image to its sweep: both come ten times a second
_SIZES = "size_3d_length", "size_3d_width", "size_3d_height"
_CARS = {"Vehicle_Car": "Car", "Vehicle_Van": "Van"}
_OCCLUSION = {"None": 0, "Light": 1, "Medium": 1, "Heavy": 2, "VeryHeavy": 2}
"""KITTI's grade by the word for it."""


def _entries(path: Path) -> dict[str, Fields]:
    """What the lists of a folder tell of each, by kind and number such as `frames/000123`."""
    found: dict[str, Fields] = {}
    inside = path.parent.name.removeprefix("single_") if path.parent.name in _FOLDERS else None  # one of them alone
    for file in sorted((path.parent.parent if inside else path).glob(_LISTS)):
        found |= _listed(file, file.stat().st_mtime_ns)
    return {name: one for name, one in found.items() if not inside or name == f"{inside}/{path.name}"}


@lru_cache(maxsize=4)
def _listed(file: Path, changed: int) -> dict[str, Fields]:  # noqa: ARG001 - a changed file is read again
    kind, found = file.name.split("-")[1], {}
    for split, entries in read_fields(file).data.items():
        for number, entry in enumerate(entries if isinstance(entries, list) else ()):
            fields = Fields(entry, f"{file}: {split}[{number}].")
            # the devkit takes both ways of writing names, `camera_frames` and `cameraFrames`
            plain = {"".join(f"_{c.lower()}" if c.isupper() else c for c in key): v for key, v in fields.data.items()}
            found[f"{kind}/{fields.get('id', str)}"] = Fields(plain, fields.where)
    return found


def _read(name: str, entry: Fields) -> DataSequence:
    """One of them; images at whose time the poses do not tell where the vehicle was are left out."""
    root = Path(entry.where.partition(": ")[0]).parent
    lens, vehicle_T_camera, vehicle_T_lidar = _calibration(root / entry.get("calibration_path", str))
    poses = _poses(root / entry.get("ego_motion_path", str))
    key = _seconds(entry, "keyframe_time")
    cameras = entry.inner("camera_frames")
    shots = {camera: list(cameras.each(camera)) for camera in cameras.data}
    labels = Fields(entry.data.get("annotations") or {}, f"{entry.where}annotations.").data.get("object_detection")
    world_T_vehicle = poses.at(0, key)
    moments: dict[str, Moment] = {}
    boxes: tuple[WorldBox, ...] = ()
    if world_T_vehicle is not None:
        if labels is not None:
            file = root / Fields(labels, f"{entry.where}annotations.object_detection.").get("filepath", str)
            boxes = _boxes(file, world_T_vehicle @ vehicle_T_lidar, tuple(shots))
        moments[name] = Moment(name, key, world_T_vehicle, boxes, labels is not None)
    sweeps = {}
    for number, scan in enumerate(Fields(entry.data.get("lidar_frames") or {}, entry.where).data.get(_LIDAR) or ()):
        scan = Fields(scan, f"{entry.where}lidar_frames.{_LIDAR}[{number}].")
        sweeps[_seconds(scan, "time")] = root / scan.get("filepath", str)
    images = []
    for camera, found in shots.items():
        times = [_seconds(shot, "time") for shot in found]
        nearest = min(times, key=lambda time: abs(time - key), default=key)
        images += [
            CameraImage(
                camera=camera,
                path=root / shot.get("filepath", str),
                name=Path(shot.get("filepath", str)).stem,
                time=time,
                lens=lens,
                vehicle_T_camera=vehicle_T_camera,
                world_T_vehicle=pose,
                moment=name if time == nearest and moments else None,
                sweep=_nearest_sweep(sweeps, time, poses, vehicle_T_lidar),
            )
            for shot, time in zip(found, times, strict=True)
            if (pose := poses.at(0, time)) is not None
        ]
    return DataSequence(name, tuple(images), moments, _CARS)


def _nearest_sweep(
    files: Mapping[float, Path], time: float, poses: CameraPoses, vehicle_T_lidar: Array
) -> Sweep | None:
    """The sweep nearest to an image, at the time of which all its points are; None where none is near."""
    near = min(files, key=lambda one: abs(one - time), default=None)
    pose = None if near is None or abs(near - time) > _FARTHEST else poses.at(0, near)
    return None if near is None or pose is None else Sweep(files[near], pose @ vehicle_T_lidar)


def _seconds(fields: Fields, name: str) -> float:
    text = fields.get(name, str)
    try:
        time = datetime.fromisoformat(text)
    except ValueError:
        raise InvalidInputError(f"{fields.where}{name}", text, "Give a time as ISO 8601 has it.") from None
    return (time if time.tzinfo else time.replace(tzinfo=UTC)).timestamp()


def _calibration(path: Path) -> tuple[Camera, Array, Array]:
    """The camera, its pose and that of the LiDAR in the vehicle's frame."""
    found = read_fields(path).inner("FC")
    mounts = [
        as_rigid(f"{found.where}{name}", found.numbers(name, (4, 4))) for name in ("extrinsics", "lidar_extrinsics")
    ]
    rows = found.get("intrinsics", list)
    columns = len(rows[0]) if rows and isinstance(rows[0], list) else 3
    width, height = (int(side) for side in found.numbers("image_dimensions", (2,)))
    with within(found.where):
        matrix = found.numbers("intrinsics", (3, min(max(columns, 3), 4)))[:, :3]
        lens = found.numbers("distortion", (4,))
        camera = Camera(matrix, distortion=lens, distortion_model="fisheye", image_size=(width, height))
    return camera, mounts[0], mounts[1]


def _poses(path: Path) -> CameraPoses:
    """Of the vehicle by time."""
    fields = read_fields(path)
    times = fields.numbers("timestamps", (len(fields.get("timestamps", list)),))
    poses = fields.numbers("poses", (len(times), 4, 4))
    order = np.argsort(times, kind="stable").tolist()
    checked = tuple(as_rigid(f"{path}: poses[{i}]", poses[i]) for i in order)
    return CameraPoses({}, tuple(times[order].tolist()), checked)


def _boxes(path: Path, world_T_lidar: Array, cameras: tuple[str, ...]) -> tuple[WorldBox, ...]:
    """Those that have a 3D box."""
    found = []
    for fields in read_records(path, "a list of labels"):
        about = fields.inner("properties")
        if "location_3d" not in about:
            continue
        quaternion = np.array([about.numbers(f"orientation_3d_q{part}", ()) for part in "wxyz"])
        turn = as_quaternion(f"{about.where}orientation_3d_qw", quaternion)
        size = as_size(f"{about.where}{_SIZES[0]}", np.array([about.numbers(part, ()) for part in _SIZES]))
        place = about.inner("location_3d").numbers("coordinates", (3,))
        drawn = box_around(_outline(fields))
        found.append(
            WorldBox(
                name=about.get("annotation_uuid", str),
                kind=_kind(about),
                world_T_box=world_T_lidar @ quaternion_pose(turn, place),
                size=size,
                occlusion=_OCCLUSION.get(str(about.data.get("occlusion_ratio")), -1),
                boxes=dict.fromkeys(cameras, drawn),
            )
        )
    return tuple(found)


def _outline(label: Fields) -> Array:
    """(N, 2) the pixels that people have marked of an object: its extreme ones."""
    geometry = label.inner("geometry")
    points = geometry.get("coordinates", list)
    if not points:
        raise InvalidInputError(f"{geometry.where}coordinates", "none", "Give the extreme pixels.")
    return numbers(points, (len(points), 2), f"{geometry.where}coordinates")


def _kind(about: Fields) -> str:
    """A class and its kind, such as `Vehicle_Car`."""
    known: list[Any] = [about.get("class", str), about.data.get("type")]
    if "Inconclusive" in known or about.data.get("unclear") is True:
        return "Unclear"
    return "_".join(str(word) for word in known if word)


READER = Reader("frame or sequence", _entries, _read)
"""The folder with the lists of ZOD, `trainval-frames-mini.json` and others, or that of one below it."""
