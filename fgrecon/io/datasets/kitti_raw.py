"""KITTI's raw data: synchronised and rectified drives of a day, with poses of the GPS unit and tracklets.

A tracklet's box stands on its origin: the centre of the bottom, in the frame of the LiDAR (forward, left, up), turned
by `rz` alone; its sizes are height, width, length. Poses are as pykitti makes them of latitude and longitude: metres of
a Mercator projection, from the place of the first one.
"""

from __future__ import annotations

import time
from collections import defaultdict
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np

from fgrecon.core.arrays import Array
from fgrecon.core.checks import as_size
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.geometry import rigid
from fgrecon.io.datasets.description import CameraImage, DataSequence, Moment, Reader, Sweep, WorldBox
from fgrecon.io.files import filled_lines, named_lines, named_matrix, numbers, read_text
from fgrecon.io.kitti_calibration import read_calibration

_CAMERAS = {f"image_{i:02d}": f"P{i}" for i in range(4)}
_CALIB, _TRACKLETS = "calib_cam_to_cam.txt", "tracklet_labels.xml"
_EARTH = 6378137.0  # metres, as KITTI's devkit has it
_CARS = {"Car": "Car", "Van": "Van"}


def _sequences(path: Path) -> dict[str, Path]:
    """The drives of a day, of days, or the one that is meant."""
    found = [path] if (path.parent / _CALIB).is_file() else [*path.glob("*_sync"), *path.glob("*/*_sync")]
    return {one.name: one for one in sorted(found) if (one / "oxts").is_dir() and (one.parent / _CALIB).is_file()}


def _read(name: str, path: Path) -> DataSequence:
    """A drive; frames without a pose are left out."""
    day = path.parent
    velo_T_imu = _motion(day / "calib_imu_to_velo.txt")
    imu_T_velo = np.linalg.inv(velo_T_imu).astype(np.float64)
    poses = _poses(path / "oxts" / "data")
    boxes = _boxes(path / _TRACKLETS)
    moments, images = {}, []
    clock = _times(path / "oxts" / "timestamps.txt")
    labelled = (path / _TRACKLETS).is_file()
    for frame, pose in list(poses.items())[: len(clock)] if labelled else ():
        here = tuple(
            WorldBox(f"{track}@{frame}", kind, pose @ imu_T_velo @ box, size, track, occlusion=occlusion)
            for track, kind, box, size, occlusion in boxes[frame]
        )
        moments[str(frame)] = Moment(str(frame), clock[frame], pose, here)
    for camera, projection in _CAMERAS.items():
        if not (path / camera).is_dir():
            continue
        read = read_calibration(day / _CALIB, projection)
        if read.camera_T_lidar is None:
            raise InvalidInputError(
                str(day / "calib_velo_to_cam.txt"), "no such file", "Give the calibration of the day."
            )
        if read.camera.image_size is None:
            field = f"{day / _CALIB}: {camera.replace('image', 'S_rect')}"
            raise InvalidInputError(field, "no such line", "Give the file as the data set has it.")
        mount = np.linalg.inv(read.camera_T_lidar @ velo_T_imu).astype(np.float64)
        times = _times(path / camera / "timestamps.txt")
        images += [
            CameraImage(
                camera=camera,
                path=path / camera / "data" / f"{frame:010d}.png",
                name=f"{frame:010d}",
                time=times[frame],
                lens=read.camera,
                vehicle_T_camera=mount,
                world_T_vehicle=pose,
                moment=str(frame) if str(frame) in moments else None,
                sweep=Sweep(path / "velodyne_points" / "data" / f"{frame:010d}.bin", pose @ imu_T_velo),
            )
            for frame, pose in poses.items()
            if frame < len(times)
        ]
    return DataSequence(name, tuple(images), moments, _CARS)


def _motion(path: Path) -> Array:
    """(4, 4) of a file with lines R and T."""
    lines = named_lines(path)
    return rigid(named_matrix(lines, "R", (3, 3), path), named_matrix(lines, "T", (1, 3), path)[0])


def _times(path: Path) -> list[float]:
    """Seconds of the frames since midnight."""
    found = []
    for place, line in filled_lines(path, "times"):
        whole, _, part = line.strip().partition(".")
        try:
            moment = time.strptime(whole, "%Y-%m-%d %H:%M:%S")
            found.append(3600 * moment.tm_hour + 60 * moment.tm_min + moment.tm_sec + float(f"0.{part or 0}"))
        except ValueError:
            raise InvalidInputError(place, line, "Give a time such as 2011-09-26 13:02:25.6.") from None
    return found


def _poses(folder: Path) -> dict[int, Array]:
    """(4, 4) world_T_imu by frame."""
    from scipy.spatial.transform import Rotation  # on use: commands start without

    rows = {int(file.stem): _row(file) for file in sorted(folder.glob("*.txt")) if file.stem.isdecimal()}
    found: dict[int, Array] = {}
    scale = np.cos(np.radians(next(iter(rows.values()))[0])) if rows else 1.0
    origin: Array | None = None
    for frame, (lat, lon, alt, roll, pitch, yaw) in rows.items():
        east, north = np.radians(lon), np.log(np.tan(np.radians(90.0 + lat) / 2.0))
        place = np.array([scale * _EARTH * east, scale * _EARTH * north, alt])
        origin = place if origin is None else origin
        found[frame] = rigid(Rotation.from_euler("ZYX", [yaw, pitch, roll]).as_matrix(), place - origin)
    return found


def _row(file: Path) -> Array:
    return numbers(read_text(file, "pose").split()[:6], 6, str(file))


def _boxes(path: Path) -> dict[int, list[tuple[str, str, Array, Array, int]]]:
    """By frame: track, kind, (4, 4) velo_T_box of the centre, (3,) length, width, height, and grade of occlusion."""
    from scipy.spatial.transform import Rotation  # on use: commands start without

    found: dict[int, list[tuple[str, str, Array, Array, int]]] = defaultdict(list)
    if not path.is_file():
        return found
    try:
        root = ET.parse(path).getroot()  # noqa: S314  # expat bounds what entities may expand to
    except (OSError, ET.ParseError) as error:
        raise InvalidInputError(str(path), str(error), "Give KITTI's XML file of tracklets.") from error
    for number, item in enumerate(root.findall("./tracklets/item")):
        where = f"{path}: item {number}: "
        height, width, length, first = (_number(item, name, where) for name in ("h", "w", "l", "first_frame"))
        size = as_size(f"{where}h, w, l", np.array([length, width, height]))
        for step, row in enumerate(item.findall("./poses/item")):
            x, y, z, yaw, grade = (_number(row, name, where) for name in ("tx", "ty", "tz", "rz", "occlusion"))
            pose = rigid(Rotation.from_euler("Z", yaw).as_matrix(), (x, y, z + height / 2.0))
            kind = (item.findtext("objectType") or "").strip()
            found[int(first) + step].append((str(number), kind, pose, size, int(grade) if 0 <= grade <= 2 else -1))
    return found


def _number(item: ET.Element, name: str, where: str) -> float:
    return float(numbers((item.findtext(name) or "").split(), 1, f"{where}{name}")[0])


READER = Reader("drive", _sequences, _read)
"""A day of KITTI's raw data, or one of its drives."""
