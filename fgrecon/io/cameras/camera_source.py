"""Camera of an image: from calibration files, whose format follows from their content, from numbers or EXIF data.

It is given of the whole image or of a part of it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.camera import Camera
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


@dataclass(frozen=True)
class PartOfImage:
    """A part of an image."""

    left: float  # columns before it
    top: float  # rows above it
    whole: tuple[int, int] | None  # (width, height) of the whole image in pixels, or None


@dataclass(frozen=True)
class CameraSource:
    """What is given about a camera; every part may be None."""

    calib: Path | None = None  # KITTI calibration file, or a folder with one for each image, of its name
    intrinsics: Sequence[float] | None = None  # fx, fy, cx, cy in pixels
    distortion: Sequence[float] | None = None  # OpenCV's 4, 5, 8, 12 or 14 coefficients
    file: str | None = None  # calibration file of any format, as `fgrecon.io.cameras.read_camera` takes it
    # part of another image that the photograph is; the camera is given for the whole image
    crop: PartOfImage | None = None
    image: NDArray[np.uint8] | None = None  # (H, W, 3) photograph, whose size counts
    # the camera that the photograph's file has (`fgrecon.io.images`), where nothing else is given
    exif: Camera | None = None
    # whether keypoints and boxes of a file that states another size of the image, of the same shape, are scaled
    # to the camera's or the photograph's
    scale_to_image: bool = False

    def __post_init__(self) -> None:
        """Refuse intrinsics beside a KITTI calibration."""
        if self.calib is not None and self.intrinsics is not None:
            text = ",".join(f"{number:g}" for number in self.intrinsics)
            raise InvalidInputError(
                "intrinsics", text, "Give either a calibration (--calib) or intrinsics (--intrinsics)."
            )

    @property
    def given(self) -> bool:
        """Whether a camera is given."""
        return any(part is not None for part in (self.calib, self.intrinsics, self.file))

    @property
    def whole(self) -> tuple[int, int] | None:
        """(width, height) in pixels of the image that the photograph is a part of, or None."""
        return None if self.crop is None else self.crop.whole

    def camera(self, image: str | None = None) -> tuple[Camera | None, NDArray[np.float64] | None]:
        """The camera, and (3,) where KITTI's label frame is from it; None where none is given.

        Args:
            image: File name of the photograph, which chooses the camera where a calibration has several.

        Raises:
            InvalidInputError: Several ways are used, or a value is no camera.
        """
        mounted = self.mounted(image)
        if mounted is not None:
            return mounted.camera, mounted.label_offset
        return (None if self.intrinsics is None else Camera.of(self.intrinsics)), None

    def mounted(self, image: str | None = None) -> MountedCamera | None:
        """The camera of the calibration file, by an image's file name, and what is said beside it; None without a file.

        Raises:
            InvalidInputError: Another way is used as well, or the file is none.
        """
        if self.file is not None and (self.calib is not None or self.intrinsics is not None):
            raise InvalidInputError(
                "camera",
                self.file,
                "Give either a camera file (--camera), a calibration (--calib) or intrinsics (--intrinsics).",
            )
        if self.calib is not None:
            of_image = self.calib / f"{Path(image).stem}.txt" if image is not None else self.calib
            calibration = read_calibration(of_image if self.calib.is_dir() else self.calib)
            return MountedCamera(calibration.camera, calibration.label_offset)
        return None if self.file is None else read_camera(self.file, image)

    def assumed(self, size: tuple[int, int]) -> Camera:
        """The EXIF camera, or one of unknown focal length, of a photograph's (width, height); of a part the whole's."""
        return self.exif or Camera.of_unknown(*self.whole_of(size))

    def whole_of(self, size: tuple[int, int]) -> tuple[int, int]:
        """(width, height) in pixels of the image whose camera is meant, from the photograph's own size.

        Raises:
            InvalidInputError: The photograph is a part of an image of unknown size.
        """
        if self.crop is None:
            return size
        if self.crop.whole is None:
            text = f"{self.crop.left:g},{self.crop.top:g}"
            raise InvalidInputError("crop", text, "Give left,top,width,height, or the camera.")
        return self.crop.whole

    def complete(self, camera: Camera, *, declared: bool) -> Camera:
        """The camera with the given distortion, of the part that the photograph is, of its size.

        Args:
            declared: Whether the user declared its image's size, if it has one; else the photograph knows better (some
                of KITTI's images are cropped).

        Raises:
            InvalidInputError: The distortion is none, the photograph is no such part, or it has another size than was
                declared.
        """
        if self.distortion is not None:
            camera = camera.with_distortion(self.distortion)
        size = None if self.image is None else (self.image.shape[1], self.image.shape[0])
        if self.crop is not None:
            whole = camera if self.crop.whole is None else replace(camera, image_size=self.crop.whole)
            return whole.cropped(self.crop.left, self.crop.top, *(size or ()))
        if size is None:
            return camera
        if declared and camera.image_size not in (None, size):
            raise InvalidInputError("image", f"{size} pixels", f"Give the image of {camera.image_size} pixels.")
        assert self.image is not None
        return camera.with_size_of(self.image)


def assumed_focal_length(camera: Camera, exif: Camera | None, cars: str = "its cars") -> str:
    """A warning of how far to trust distances where no camera is given.

    Args:
        exif: The one that the photograph's file has, or None.
        cars: Whose looks it was estimated from, in words.
    """
    source = f"what {cars} look like" if exif is None else f"the EXIF data and {cars}"
    return (
        f"No camera is given: the focal length is {camera.matrix[0, 0]:.0f} px, known to "
        f"{100 * camera.focal_sigma:.0f} %, from {source}. Distances are as rough. "
        "Give a camera file or intrinsics (--camera, --intrinsics)."
    )
