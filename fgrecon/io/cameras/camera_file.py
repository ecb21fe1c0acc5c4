"""One entry to calibration files: the format follows from the content."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from fgrecon.core.errors import InvalidInputError
from fgrecon.io.cameras.rigs import MountedCamera, is_waymo, nuscenes_camera, waymo_camera
from fgrecon.io.cameras.slam_files import is_slam_file, slam_camera
from fgrecon.io.cameras.structure import colmap_camera, is_colmap, is_nerfstudio, nerfstudio_camera
from fgrecon.io.datasets import is_data_set, open_sequence
from fgrecon.io.json_fields import Fields, read_json
from fgrecon.io.keypoint_file import parse_camera
from fgrecon.io.kitti_calibration import read_calibration
from fgrecon.io.nuscenes import is_nuscenes, open_nuscenes


def read_camera(source: str | Path, image: str | None = None) -> MountedCamera:
    """Read a camera from a calibration file.

    Args:
        source: KITTI's calibration (object, tracking, odometry, raw), YAML of ROS, OpenCV, Kalibr, ORB-SLAM or VINS,
            XML of OpenCV, JSON of Waymo, nerfstudio, OpenCV or with the fields of a keypoint file (`K`), COLMAP's
            `cameras.txt` or `.bin`, or the folder of a data set. Of several cameras one is named after the file:
            `FILE#P3`, `FOLDER#CAM_FRONT`, `FOLDER#SEQUENCE/CAMERA`, `FILE#FRONT`; `#projection_matrix` is ROS's
            rectified camera.
        image: File name of the photograph, by which data sets, COLMAP and nerfstudio tell the camera.

    Raises:
        InvalidInputError: The file cannot be read, has no such camera, or is malformed; names file and field.
    """
    path, name = _split(source)
    if is_nuscenes(path) and "/" not in (name or ""):
        return nuscenes_camera(open_nuscenes(path), None if name else image, name)
    if path.is_dir():
        return _of_data_set(source, image)
    where = f"{path}: "
    ending = path.suffix.lower()
    if ending == ".json":
        data = read_json(path)
        if is_waymo(data):
            return waymo_camera(data, name, where)
        if is_nerfstudio(data):
            return nerfstudio_camera(data, image, name, where)
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
        if is_slam_file(data):
            return MountedCamera(slam_camera(data, name, where))
        if not isinstance(data, Mapping):
            raise InvalidInputError(str(path), type(data).__name__, "Give a calibration of ROS or OpenCV.")
        return MountedCamera(storage_camera(data, where, name))
    if is_colmap(path):
        return MountedCamera(colmap_camera(path, image, name))
    calibration = read_calibration(path, "P2" if name is None else name)
    return MountedCamera(calibration.camera, label_offset=calibration.label_offset)


def _of_data_set(source: str | Path, image: str | None) -> MountedCamera:
    """The camera of a data set that took an image, or that is named."""
    if not is_data_set(source):
        raise InvalidInputError("camera", str(source), "Give a file, or a folder of a data set.")
    found, camera = open_sequence(source)
    images = found.images if camera is None else found.of_camera(camera)
    named = [one for one in images if image is not None and one.path.stem == Path(image).stem]
    if len(named) == 1:
        return MountedCamera(named[0].lens, world_T_camera=named[0].world_T_camera if found.continuous else None)
    cameras = {one.camera: one.lens for one in named or images}
    if len(cameras) != 1:
        fix = f"Name the camera after the folder: {found.name}/{' or '.join(cameras)}."
        raise InvalidInputError("camera", f"{len(cameras)} cameras of {source}", fix)
    return MountedCamera(next(iter(cameras.values())))


def _split(source: str | Path) -> tuple[Path, str | None]:
    """Path and name of a camera; a file may have the sign in its own name."""
    path = Path(source)
    text, sign, name = str(source).rpartition("#")
    try:
        whole = path.exists()
    except OSError as error:
        raise InvalidInputError("camera", str(source), f"Give a file that can be read ({error.strerror}).") from error
    return (path, None) if whole or not (sign and name) else (Path(text), name)
