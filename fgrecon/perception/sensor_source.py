"""What other sensors' files say of an image: from files, folders or patterns to evidence."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.errors import InvalidInputError
from fgrecon.core.evidence import Evidence, Points
from fgrecon.io.cameras.camera_source import CameraSource
from fgrecon.io.kitti_calibration import KittiCalibration
from fgrecon.io.nuscenes import is_nuscenes, open_nuscenes, sweep_of
from fgrecon.io.sensors.clouds import CLOUDS
from fgrecon.io.sensors.lidar_place import Place, lidar_place
from fgrecon.io.sensors.points import read_points
from fgrecon.io.sensors.sensor_files import SensorFiles


@dataclass(frozen=True)
class SensorSource:
    """What is given beside the images; every part may be None.

    Attributes:
        lidar: Points: a file, a folder with one for each image, of its name, or a pattern.
        lidar_pose: File with the motion from the LiDAR's frame to the camera's.
        camera: What is given of the camera.
    """

    lidar: str | None = None
    lidar_pose: Path | None = None
    camera: CameraSource = field(default_factory=CameraSource)

    def __post_init__(self) -> None:
        """Refuse a pose of nothing, and what has no files.

        Raises:
            InvalidInputError: There is a pose but no LiDAR, or there are no files.
        """
        if self.lidar is None and self.lidar_pose is not None:
            raise InvalidInputError("lidar_pose", str(self.lidar_pose), "Give the LiDAR's points as well (--lidar).")
        if self._clouds is not None:
            self._clouds.all()

    @property
    def given(self) -> bool:
        """Whether there is anything."""
        return self.lidar is not None

    def to_dict(self) -> dict[str, str]:
        """What is given, for the settings of a run: a file or a folder by its absolute path."""
        named = {"lidar": self.lidar, "lidar_pose": self.lidar_pose}
        return {name: str(Path(one).absolute()) for name, one in named.items() if one is not None}

    @property
    def _clouds(self) -> SensorFiles | None:
        return None if self.lidar is None else SensorFiles("lidar", self.lidar, CLOUDS)

    def check(self, images: Iterable[str]) -> None:
        """Refuse files of which none is of one of the images.

        Args:
            images: Their names.

        Raises:
            InvalidInputError: There is none.
        """
        names = list(images)
        files = self._clouds
        if files is not None and not any(self._file(files, Path(name)) for name in names):
            named = names[0] if names else "none"
            raise InvalidInputError(files.field, files.given, f"Name its files as the images, such as {named}.")

    def evidence(self, path: Path) -> tuple[Evidence, ...]:
        """What the files say of an image; nothing where there is none of it.

        Args:
            path: The image's file, or its name where it is a frame of a video.

        Raises:
            InvalidInputError: A file cannot be used, or nothing says where its sensor is.
        """
        clouds = self._clouds
        cloud = None if clouds is None else self._file(clouds, path)
        if cloud is None:
            return ()
        place = lidar_place(cloud, path, self.camera, self.lidar_pose)
        return (Points(read_points(cloud, place), origin=_origin(place)),)

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
