"""One entry to calibration files: the format follows from what a file holds."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from fgrecon.core.errors import InvalidInputError
from fgrecon.io.cameras.rigs import MountedCamera, is_waymo, nuscenes_camera, waymo_camera
from fgrecon.io.json_fields import Fields, read_json
from fgrecon.io.keypoint_file import parse_camera
from fgrecon.io.kitti_calibration import read_calibration
from fgrecon.io.nuscenes import is_nuscenes, open_nuscenes


def read_camera(source: str | Path, image: str | None = None) -> MountedCamera:
    """Read a camera from a calibration file.

    Args:
        source: KITTI's calibration (object, tracking, odometry, raw), YAML of ROS or OpenCV, XML of OpenCV, JSON of
            Waymo, of OpenCV or with the fields of a keypoint file (`K`), or the folder of nuScenes' tables. Of several
            cameras one is named after the file: `FILE#P3`, `FOLDER#CAM_FRONT`, `FILE#FRONT`; `#projection_matrix` is
            ROS's rectified camera.
        image: File name of the photograph, by which nuScenes tells the camera.

    Raises:
        InvalidInputError: The file cannot be read, has no such camera, or is malformed; names file and field.
    """
    path, name = _split(source)
    if is_nuscenes(path):
        return nuscenes_camera(open_nuscenes(path), None if name else image, name)
    if path.is_dir():
        raise InvalidInputError("camera", str(path), "Give a file, or a folder with nuScenes' tables.")
    where = f"{path}: "
    ending = path.suffix.lower()
    if ending == ".json":
        data = read_json(path)
        if is_waymo(data):
            return waymo_camera(data, name, where)
        fields = Fields(data, where)
        rows = fields.data.get("K")
        ours = "intrinsics" in fields or (isinstance(rows, list) and any(isinstance(row, list) for row in rows))
        camera = parse_camera(fields) if ours and name is None else None
        if camera is not None:
            return MountedCamera(camera)
        from fgrecon.io.cameras.storage import storage_camera

        return MountedCamera(storage_camera(data, where, name))
    if ending in (".yaml", ".yml", ".xml"):
        from fgrecon.io.cameras.storage import read_storage, storage_camera  # on use: it imports yaml

        data = read_storage(path)
        if not isinstance(data, Mapping):
            raise InvalidInputError(str(path), type(data).__name__, "Give a calibration of ROS or OpenCV.")
        return MountedCamera(storage_camera(data, where, name))
    calibration = read_calibration(path, "P2" if name is None else name)
    return MountedCamera(calibration.camera, label_offset=calibration.label_offset)


def _split(source: str | Path) -> tuple[Path, str | None]:
    """Path and name of a camera; a file may have the sign in its own name."""
    path = Path(source)
    text, sign, name = str(source).rpartition("#")
    try:
        whole = path.exists()
    except OSError as error:
        raise InvalidInputError("camera", str(source), f"Give a file that can be read ({error.strerror}).") from error
    return (path, None) if whole or not (sign and name) else (Path(text), name)
