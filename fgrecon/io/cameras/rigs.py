"""Cameras as they are mounted on vehicles: nuScenes' tables and Waymo's calibrations."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.camera import Camera, Ground
from fgrecon.core.errors import InvalidInputError
from fgrecon.io.datasets import waymo
from fgrecon.io.json_fields import Fields, within
from fgrecon.io.nuscenes import NuScenesTables, pose_of


@dataclass(frozen=True, eq=False)
class MountedCamera:
    """A camera, and what its file says beside it."""

    camera: Camera
    # (3,) t in metres: KITTI's label frame lies so from the camera's (a labelled point is at X + t); None where
    # the file is none of KITTI's
    label_offset: NDArray[np.float64] | None = None
    # the ground in the camera's frame, where the file says how high and in which direction it is mounted
    ground: Ground | None = None
    # (4, 4) pose of the camera in the world when it took the image, or None
    world_T_camera: NDArray[np.float64] | None = None


def ground_below(vehicle_T_camera: NDArray[np.float64]) -> Ground | None:
    """The plane z = 0 of a vehicle whose z axis points up, in the frame of a camera on it at a pose (4, 4), metres.

    Returns:
        The plane; None where the camera is upside down or not above it.
    """
    normal, height = -vehicle_T_camera[2, :3], float(vehicle_T_camera[2, 3])
    return Ground(normal, height) if normal[1] > 0.0 and height > 0.0 else None


_WAYMO_LISTS = "camera_calibrations", "cameraCalibrations"


def nuscenes_camera(tables: NuScenesTables, image: str | None, name: str | None) -> MountedCamera:
    """The camera that took an image of nuScenes, or of a channel where all vehicles have the same.

    nuScenes' images are without distortion; where a table has `camera_distortion`, as in the format of TIER IV, it is
    taken for OpenCV's coefficients.

    Args:
        image: File name of the image, or None.
        name: Channel, such as CAM_FRONT, or None.

    Raises:
        InvalidInputError: There is no such image or channel, several cameras fit, or a record is malformed.
    """
    size = world_T_vehicle = None
    if image is not None:
        record = tables.image(image)
        sensor = tables.named(record, "calibrated_sensor_token", "calibrated_sensor")
        if "width" in record and "height" in record:
            size = record.get("width", int), record.get("height", int)
        world_T_vehicle = pose_of(tables.named(record, "ego_pose_token", "ego_pose"))
    else:
        sensor = _channel(tables, name)
    vehicle_T_camera = pose_of(sensor)
    lens = sensor.data.get("camera_distortion") or None
    distortion = (
        None if lens is None else sensor.numbers("camera_distortion", (len(sensor.get("camera_distortion", list)),))
    )
    return MountedCamera(
        _camera(sensor, sensor.numbers("camera_intrinsic", (3, 3)), distortion, size),
        ground=ground_below(vehicle_T_camera),
        world_T_camera=None if world_T_vehicle is None else world_T_vehicle @ vehicle_T_camera,
    )


def _channel(tables: NuScenesTables, name: str | None) -> Fields:
    """The calibrated sensor of a channel."""
    channels = {token: sensor.get("channel", str) for token, sensor in tables.table("sensor").items()}
    wanted = {token for token, channel in channels.items() if channel == name}
    known = ", ".join(sorted(channel for channel in channels.values() if channel.startswith("CAM")))
    fix = f"Name the photograph of nuScenes, or a channel after the file: {tables.folder}#CAM_FRONT ({known})."
    if not wanted:
        raise InvalidInputError("camera", "no channel" if name is None else name, fix)
    fitting = [s for s in tables.table("calibrated_sensor").values() if s.get("sensor_token", str) in wanted]
    cameras = {
        str((s.data.get("camera_intrinsic"), s.data.get("translation"), s.data.get("rotation"))) for s in fitting
    }
    if len(cameras) != 1:
        raise InvalidInputError(
            "camera", f"{len(cameras)} calibrations of {name}", "Name the photograph (`image`, --image)."
        )
    return fitting[0]


def is_waymo(data: Any) -> bool:
    """Whether the content of a JSON file is Waymo's calibration of one camera or of several."""
    entries = _waymo_entries(data)
    return bool(entries) and all(isinstance(entry, Mapping) and "intrinsic" in entry for entry in entries)


def waymo_camera(data: Any, name: str | None, where: str) -> MountedCamera:
    """A camera of Waymo's calibration as JSON: `intrinsic` is f_u, f_v, c_u, c_v, k_1, k_2, p_1, p_2, k_3.

    Args:
        name: Which camera, such as FRONT; None for the only one.
    """
    found: dict[str, Fields] = {}
    for number, entry in enumerate(_waymo_entries(data)):
        fields = Fields(entry, f"{where}[{number}].")
        title = fields.data.get("name", number)
        found[str(waymo.CAMERAS.get(title, title) if isinstance(title, int) else title)] = fields
    fields = found[named_camera(found, name, where)]
    fx, fy, cx, cy, *lens = fields.numbers("intrinsic", (9,)).tolist()
    matrix = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
    size = (fields.get("width", int), fields.get("height", int)) if "width" in fields else None
    return MountedCamera(_camera(fields, matrix, np.array(lens), size))


def _waymo_entries(data: Any) -> list[Any]:
    if isinstance(data, Mapping):
        inner = data.get("context", data)
        lists = [inner.get(name) for name in _WAYMO_LISTS] if isinstance(inner, Mapping) else []
        data = next((entries for entries in lists if entries is not None), [data])
    return data if isinstance(data, list) else []


def _camera(fields: Fields, matrix: Any, distortion: Any, size: tuple[int, int] | None) -> Camera:
    if size is not None and min(size) < 1:
        raise InvalidInputError(f"{fields.where}width, height", size, "Give pixels, from 1.")
    with within(fields.where):
        return Camera(matrix, distortion, size)


def named_camera(cameras: Collection[str], name: str | None, where: str) -> str:
    """The camera of a name; the only one where none is given.

    Raises:
        InvalidInputError: There is none of the name, or there are several and none is named; lists them.
    """
    if name in cameras:
        return str(name)
    if name is None and len(cameras) == 1:
        return next(iter(cameras))
    fix = f"Name one after the file, FILE#NAME: {', '.join(cameras) or 'there is none'}."
    raise InvalidInputError(f"{where}camera", name or f"{len(cameras)} cameras", fix)
