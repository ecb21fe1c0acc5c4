"""KITTI-360: sequences of images with boxes in one world.

A box is eight vertices, half a metre to each side, and a `transform` whose columns are the axes forward, left, up times
length, width, height. Boxes without a `timestamp` (-1) stand still, and are taken for the frames from `start_frame` to
`end_frame`. Poses are those of the GPS unit; the rectified images have `P_rect`, turned by `R_rect`, and the two
fisheyes (`image_02.yaml`) are as they were taken.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np

from fgrecon.core.arrays import Array
from fgrecon.core.camera import Camera
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.geometry import rigid
from fgrecon.core.lens import MEI
from fgrecon.io.datasets.description import CameraImage, DataSequence, Moment, Reader, Sweep, WorldBox
from fgrecon.io.files import as_pose, filled_lines, named_lines, named_matrix, named_pose, numbers, read_text

_CAMERAS = {"image_00": "data_rect", "image_01": "data_rect", "image_02": "data_rgb", "image_03": "data_rgb"}
"""Folders of the images; the last two are fisheyes."""
_SCANS = "velodyne_points/data"
_RATE = 10.0  # frames per second, about
_STATIC = -1
_MEI = "xi", "k1", "k2", "p1", "p2"
_KINDS = {13: "car", 14: "truck", 15: "trailer", 16: "caravan", 17: "motorcycle", 18: "bicycle", 19: "person"} | {
    20: "rider",
    33: "train",
    34: "bus",
    36: "unknown vehicle",
}
"""Names by KITTI-360's numbers of the classes of things that move; its devkit's `kittiId`."""
_CARS = {"car": "Car"}


def _sequences(path: Path) -> dict[str, Path]:
    """The folder by the names of the sequences that have poses."""
    if not (path / "calibration" / "perspective.txt").is_file():
        return {}
    return {file.parent.name: path for file in sorted((path / "data_poses").glob("*/poses.txt"))}


def _read(name: str, path: Path) -> DataSequence:
    """A sequence; frames without a pose are left out."""
    poses = _frames(path / "data_poses" / name / "poses.txt")
    labels = next((f for part in ("train", "train_full", "test") if (f := _labels(path, part, name)).is_file()), None)
    boxes = {} if labels is None else _boxes(labels, tuple(poses))
    moments = {
        str(frame): Moment(
            name=str(frame),
            time=frame / _RATE,
            world_T_vehicle=pose,
            boxes=tuple(boxes[frame]),
        )
        for frame, pose in poses.items()
        if frame in boxes
    }
    mounts = named_lines(path / "calibration" / "calib_cam_to_pose.txt")
    intrinsics = named_lines(path / "calibration" / "perspective.txt")
    vehicle_T_velo = _velo(path, mounts)
    images = []
    for camera, part in _CAMERAS.items():
        own = path / "calibration" / f"{camera}.yaml"
        if part == "data_rgb" and not own.is_file():
            continue
        lens, turn = (_fisheye(own), np.eye(4)) if part == "data_rgb" else _lens(intrinsics, camera, path)
        vehicle_T_camera = named_pose(mounts, camera, path / "calibration") @ np.linalg.inv(turn)
        folder, scans = path / "data_2d_raw" / name / camera / part, path / "data_3d_raw" / name / _SCANS
        images += [
            CameraImage(
                camera=camera,
                path=folder / f"{frame:010d}.png",
                name=f"{frame:010d}",
                time=frame / _RATE,
                lens=lens,
                vehicle_T_camera=vehicle_T_camera,
                world_T_vehicle=pose,
                moment=str(frame) if frame in boxes else None,
                sweep=None if vehicle_T_velo is None else Sweep(scans / f"{frame:010d}.bin", pose @ vehicle_T_velo),
            )
            for frame, pose in poses.items()
        ]
    return DataSequence(name, tuple(images), moments, _CARS)


def _velo(path: Path, mounts: Mapping[str, list[str]]) -> Array | None:
    """(4, 4) from the LiDAR's frame to the vehicle's; None without its calibration."""
    file = path / "calibration" / "calib_cam_to_velo.txt"
    if not file.is_file():
        return None
    velo_T_camera = as_pose(numbers(read_text(file, "calibration").split(), 12, str(file)))
    return named_pose(mounts, "image_00", path / "calibration") @ np.linalg.inv(velo_T_camera)


def _labels(path: Path, part: str, name: str) -> Path:
    return path / "data_3d_bboxes" / part / f"{name}.xml"


def _frames(path: Path) -> dict[int, Array]:
    """(4, 4) world_T_vehicle by frame."""
    found = {}
    for place, line in filled_lines(path, "poses"):
        values = numbers(line.split(), 13, place)
        found[int(values[0])] = as_pose(values[1:])
    return found


def _lens(lines: Mapping[str, list[str]], camera: str, path: Path) -> tuple[Camera, Array]:
    """The rectified camera, and (4, 4) its turn from the camera as it is mounted."""
    side, where = camera[-2:], path / "calibration" / "perspective.txt"
    turn = rigid(named_matrix(lines, f"R_rect_{side}", (3, 3), where), 0.0)
    width, height = named_matrix(lines, f"S_rect_{side}", (1, 2), where)[0].astype(int).tolist()
    return Camera(named_matrix(lines, f"P_rect_{side}", (3, 4), where)[:, :3], image_size=(width, height)), turn


def _fisheye(file: Path) -> Camera:
    """The camera of a file as camodocal writes it; no two of its values have the same name."""
    lines, names = named_lines(file), ("gamma1", "gamma2", "u0", "v0", *_MEI, "image_width", "image_height")
    values = [float(named_matrix(lines, name, (1, 1), file)[0, 0]) for name in names]
    fx, fy, cx, cy, *lens, width, height = values
    matrix = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
    return Camera(matrix, np.array(lens), (int(width), int(height)), distortion_model=MEI)


@lru_cache(maxsize=2)
def _boxes(path: Path, frames: tuple[int, ...]) -> Mapping[int, list[WorldBox]]:
    """The boxes of each frame that the file speaks of."""
    try:
        root = ET.parse(path).getroot()  # noqa: S314  # expat bounds what entities may expand to
    except (OSError, ET.ParseError) as error:
        raise InvalidInputError(str(path), str(error), "Give an XML file of KITTI-360's boxes.") from error
    found: dict[int, list[WorldBox]] = defaultdict(list)
    for item in root:
        if item.find("transform") is None or item.find("semanticId") is None:
            continue  # a surface, such as the ground
        where = f"{path}: {item.tag}."
        start, end, time, kind, instance = (
            _whole(item, name, where) for name in ("start_frame", "end_frame", "timestamp", "semanticId", "instanceId")
        )
        pose, size = _box(item, where)
        shown = [time] if time != _STATIC else [frame for frame in frames if start <= frame <= end]
        track = f"{kind}-{instance}"
        for frame in shown:
            found[frame].append(WorldBox(f"{item.tag}@{frame}", _KINDS.get(kind, str(kind)), pose, size, track))
    return found


def _box(item: ET.Element, where: str) -> tuple[Array, Array]:
    """Pose of the centre with axes forward, left, up, and length, width and height."""
    matrix, vertices = _opencv(item, "transform", where), _opencv(item, "vertices", where)
    scaled, scale = matrix[:3, :3], np.linalg.norm(matrix[:3, :3], axis=0)
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    if matrix.shape != (4, 4) or vertices.shape != (8, 3) or not (scale > 0.0).all() or not (high > low).all():
        raise InvalidInputError(f"{where}transform", matrix.tolist(), "Give 4x4 numbers and the vertices of a box.")
    axes = scaled / scale
    if np.abs(axes.T @ axes - np.eye(3)).max() > 1e-3:
        raise InvalidInputError(f"{where}transform", matrix.tolist(), "Give axes at right angles.")
    if np.linalg.det(axes) < 0.0:  # mirrored: the same box with its left on the other side
        axes[:, 1] = -axes[:, 1]
        low[1], high[1] = -high[1], -low[1]
    return rigid(axes, matrix[:3, 3] + axes @ (scale * (low + high) / 2.0)), scale * (high - low)


def _opencv(item: ET.Element, name: str, where: str) -> Array:
    """A matrix as OpenCV writes it."""
    node = item.find(name)
    parts = [] if node is None else [node.findtext(part) for part in ("rows", "cols", "data")]
    try:
        rows, columns, data = (part or "" for part in parts)
        return numbers(data.split(), int(rows) * int(columns), f"{where}{name}").reshape(int(rows), int(columns))
    except ValueError:
        raise InvalidInputError(f"{where}{name}", "no matrix", "Give rows, cols and data.") from None


def _whole(item: ET.Element, name: str, where: str) -> int:
    text = item.findtext(name)
    try:
        return int(text or "")
    except ValueError:
        raise InvalidInputError(f"{where}{name}", text, "Give a whole number.") from None


READER = Reader("sequence", _sequences, _read)
"""KITTI-360's folder."""
