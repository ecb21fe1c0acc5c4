"""Evidence of an image from other sensors' files, folders or patterns."""

from __future__ import annotations

import warnings
from collections.abc import Iterable
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.choices import DepthScale
from fgrecon.core.depth_map import DepthMap
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.evidence import Evidence, Points, StereoPair
from fgrecon.core.geometry import rigid
from fgrecon.io.cameras.camera_source import CameraSource, read_camera
from fgrecon.io.images import read_image
from fgrecon.io.kitti_calibration import KittiCalibration, calibration_beside, read_calibration
from fgrecon.io.nuscenes import is_nuscenes, open_nuscenes, sweep_of
from fgrecon.io.poses import read_pose
from fgrecon.io.sensors.pixel_files import DEPTHS, MASKS, as_per_metre, read_depth, read_masks
from fgrecon.io.sensors.points import CLOUDS, NoPointError, Place, lidar_place, read_points
from fgrecon.io.sensors.sensor_files import DataSetSweeps, SensorFiles
from fgrecon.perception.stereo import stereo_depth

IMAGES = (".png", ".jpg", ".jpeg")
"""Endings of right images."""


@dataclass(frozen=True)
class SensorSource:
    """What is given beside the images; every part may be None."""

    lidar: str | None = None  # points: a file, a folder with one for each image, of its name, a pattern, or a data set
    lidar_pose: Path | None = None  # file with the motion from the LiDAR's frame to the camera's
    lidar_sigma: tuple[float, float] = (0.0, 0.0)  # how unsure that is, radians and metres (`Points.place_sigma`)
    masks: str | None = None  # masks of the vehicles: as `lidar`, or COCO JSON of all images
    camera: CameraSource = field(default_factory=CameraSource)  # what is given of the camera
    depth: str | None = None  # depth maps, in the same way
    depth_scale: DepthScale = DepthScale.METRIC  # whether their numbers are metres
    depth_inverse: bool = False  # whether they are inverse depths
    depth_per_metre: float | None = None  # how many of their units a metre is; None as `read_depth` has it
    right: str | None = None  # right images of pairs, in the same way; KITTI's calibration has both cameras
    right_camera: str | None = None  # the right camera, as `--camera` takes it; None for that of the calibration
    right_pose: Path | None = None  # file with the motion from the left camera's frame to the right one's

    def __post_init__(self) -> None:
        """Refuse a pose of nothing, and what has no files."""
        if self.lidar is None and any(self.lidar_sigma):
            raise InvalidInputError("lidar_sigma", self.lidar_sigma, "Give the LiDAR's points as well (--lidar).")
        if self.lidar is None and self.lidar_pose is not None:
            raise InvalidInputError("lidar_pose", str(self.lidar_pose), "Give the LiDAR's points as well (--lidar).")
        if self.right is None and (self.right_pose is not None or self.right_camera is not None):
            value = str(self.right_pose or self.right_camera)
            raise InvalidInputError("right_pose", value, "Give the right images as well (--right).")
        if self.depth is None and (self.depth_inverse or self.depth_scale is not DepthScale.METRIC):
            raise InvalidInputError("depth_scale", self.depth_scale.value, "Give the depth maps as well (--depth).")
        if self.depth_per_metre is not None:
            units = as_per_metre(self.depth_per_metre)
            if self.depth is None:
                raise InvalidInputError("depth_per_metre", units, "Give the depth maps as well (--depth).")
            if not self._metres:
                fix = "Leave it out of inverse depths, and of maps whose scale is to be found (--depth-scale)."
                raise InvalidInputError("depth_per_metre", units, fix)
        for files in self._files:
            files.all()
        if self._sweeps is not None and self.lidar_pose is not None:
            raise InvalidInputError("lidar_pose", str(self.lidar_pose), "Leave it out: the data set has it.")

    @property
    def given(self) -> bool:
        """Whether there is anything."""
        return bool(self._files or self._sweeps)

    def to_dict(self) -> dict[str, str]:
        """What is given, for the settings of a run: a file or a folder by its absolute path."""
        names = "lidar", "lidar_pose", "masks", "depth", "right", "right_camera", "right_pose"
        given = {name: one for name in names if (one := getattr(self, name)) is not None}
        found = {name: str(Path(one).absolute()) for name, one in given.items()}
        if any(self.lidar_sigma):
            found["lidar_sigma"] = "{:g},{:g}".format(*self.lidar_sigma)
        if self.depth is not None:
            found |= {"depth_scale": self.depth_scale.value, "depth_inverse": str(self.depth_inverse).lower()}
        if self.depth_per_metre is not None:
            found["depth_per_metre"] = f"{self.depth_per_metre:g}"
        return found

    @property
    def _metres(self) -> bool:
        """Whether depth maps are in metres, or known units of them."""
        return self.depth_scale is DepthScale.METRIC and not self.depth_inverse

    @cached_property
    def _files(self) -> list[SensorFiles]:
        """The files that are given, of each kind."""
        lidar = [] if self._sweeps is not None else [("lidar", CLOUDS)]
        given = *lidar, ("masks", MASKS), ("depth", DEPTHS), ("right", IMAGES)
        named = [(name, getattr(self, name), endings) for name, endings in given]
        return [SensorFiles(name, value, endings) for name, value, endings in named if value is not None]

    @cached_property
    def _sweeps(self) -> DataSetSweeps | None:
        """Those of the data set that is given for the LiDAR."""
        return DataSetSweeps.of_source(self.lidar)

    def check(self, images: Iterable[str]) -> None:
        """Refuse files of which none is of one of the images, by their names."""
        names = list(images)
        for files in self._files:
            if not any(self._file(files, Path(name)) for name in names):
                named = names[0] if names else "none"
                raise InvalidInputError(files.field, files.given, f"Name its files as the images, such as {named}.")
        if self._sweeps is not None and not any(map(self._sweeps.of, names)):
            raise InvalidInputError(
                "lidar", str(self.lidar), "Give the data set, and the camera, that the images are of."
            )

    def evidence(self, path: Path) -> tuple[Evidence, ...]:
        """What the files say of an image, by its file or a video frame's name; nothing where there is none of it.

        Raises:
            InvalidInputError: A file cannot be used, or nothing says where its sensor is.
        """
        given = ((one, file) for one in self._files if (file := self._file(one, path)) is not None)
        swept = None if self._sweeps is None else self._sweeps.of(path.name)
        found: list[Evidence] = [] if swept is None else [self._points(*swept)]
        for one, file in given:
            if one.field == "lidar":
                found.append(self._points(file, lidar_place(file, path, self.camera, self.lidar_pose)))
            elif one.field == "masks":
                found += read_masks(file, path)
            elif one.field == "depth":
                numbers = read_depth(file, self.depth_per_metre if self._metres else 1.0)
                found.append(DepthMap(numbers, scale=self.depth_scale, inverse=self.depth_inverse))
            else:
                found.append(self._of_pair(path, file))
        return tuple(found)

    def _points(self, file: Path, place: Place | None) -> Points:
        """The points of a scan, by where the LiDAR is; none of an empty one, unless it is the only one."""
        points = np.zeros((0, 3))
        try:
            points = read_points(file, place)
        except NoPointError:
            if str(file) == self.lidar:
                raise
            warnings.warn(f"{file} has no finite point: its image goes without.", stacklevel=2)
        return Points(points, origin=_origin(place), place_sigma=self.lidar_sigma)

    def _of_pair(self, path: Path, right: Path) -> DepthMap:
        """The depth of an image that is the left one of a pair."""
        if not path.is_file():
            raise InvalidInputError("right", f"{right.name} for {path.name}", "Give left images that are files.")
        if self.right_pose is None:
            first, second = self._of_kitti(path, right)
            camera, other = first.camera, second.camera
            motion = rigid(np.eye(3), second.label_offset - first.label_offset)
        else:
            given = self.camera.camera(path.name)[0]
            if given is None:
                fix = "Give the left camera as well (--camera, --calib or --intrinsics)."
                raise InvalidInputError("right_pose", str(self.right_pose), fix)
            camera = other = self.camera.complete(given, declared=False)
            motion = read_pose(self.right_pose, "right_pose", "from the left camera's frame to the right one's")
        if self.right_camera is not None:
            other = read_camera(self.right_camera, right.name).camera
        left = read_image(path)
        return stereo_depth(left, camera.with_size_of(left), StereoPair(read_image(right), other, motion))

    def _of_kitti(self, path: Path, right: Path) -> tuple[KittiCalibration, KittiCalibration]:
        """The left and the right camera of KITTI's calibration."""
        given = self.camera.calib
        if given is not None:
            file = given / f"{path.stem}.txt" if given.is_dir() else given
            return read_calibration(file), read_calibration(file, "P3")
        first, second = calibration_beside(path), calibration_beside(right)
        if first is None or second is None:
            fix = (
                "Give KITTI's calibration, which has P2 and P3 (--calib), or where the right camera is (--right-pose)."
            )
            raise InvalidInputError("right", f"{right.name} for {path.name}", fix)
        return first, second

    def _file(self, files: SensorFiles, image: Path) -> Path | None:
        found = files.of(image.name)
        tables = self.camera.file
        if found is None and tables is not None and is_nuscenes(Path(tables)):
            sweep = sweep_of(open_nuscenes(Path(tables)), image.name)
            return None if sweep is None else files.of(sweep.removesuffix(".pcd.bin"))
        return found


def _origin(place: Place | None) -> NDArray[np.float64]:
    """(3,) where the sensor is in the camera's frame, as far as that is known."""
    motion = place.camera_T_lidar if isinstance(place, KittiCalibration) else place
    return np.zeros(3) if motion is None else motion[:3, 3]
