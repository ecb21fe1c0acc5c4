"""Options for other sensors' files, shared by several commands."""

from __future__ import annotations

import math
from dataclasses import dataclass
from glob import glob
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

from fgrecon.cli.commands import option
from fgrecon.core.choices import DepthScale
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.parsing import parse_numbers

if TYPE_CHECKING:  # the command line must start fast: what the commands need is imported when they run
    from fgrecon.io.bag_drive import LidarTopic
    from fgrecon.io.cameras.camera_source import CameraSource
    from fgrecon.perception.sensor_source import SensorSource

_FILES = "FILE|FOLDER|PATTERN"


@dataclass(frozen=True)
class SensorOptions:
    """What other sensors measured: files of their own for each image, named as it."""

    panel: ClassVar = "Other sensors"

    lidar: str | None = option(
        "Points of a LiDAR: KITTI's or nuScenes' bin, npz, npy, pcd, ply, las; named as the images. Or the "
        "data set that has them; of a bag its topic.",
        metavar=f"{_FILES}|DATASET",
    )
    lidar_pose: Path | None = option(
        "From the points' frame to the camera's: 12 numbers [R | t], or JSON with a matrix.",
        metavar="FILE",
        show_default="by KITTI's calibration, nuScenes' tables or the bag's TF",
    )
    lidar_sigma: str | None = option(
        "How unsure that is: the cars of an image then tell how the LiDAR is turned and shifted (1 sigma).",
        metavar="DEGREES,METRES",
        show_default="exact",
    )
    depth: str | None = option(
        "Depth maps as large as the images: KITTI's png of 16 bits, npy, npz, tiff, exr, pfm.", metavar=_FILES
    )
    depth_scale: DepthScale = option(
        "What a depth network's numbers are: metres, or to be scaled.", default=DepthScale.METRIC
    )
    depth_per_metre: float | None = option(
        "How many of their units are a metre: 1000 of millimetres, 5000 in TUM's RGB-D.",
        metavar="NUMBER",
        show_default="1; of png 256, as KITTI's",
    )
    depth_inverse: bool = option("They are inverse depths, as disparities.", "--depth-inverse", default=False)
    right: str | None = option("Right images of pairs; KITTI's calibration has both cameras.", metavar=_FILES)
    right_pose: Path | None = option(
        "From the left camera's frame to the right one's: 12 numbers [R | t], or JSON with a matrix.",
        metavar="FILE",
        show_default="by KITTI's calibration",
    )
    right_camera: str | None = option(
        "The right camera, as --camera takes it.", metavar="FILE", show_default="as the left one"
    )
    masks: str | None = option("Masks of the vehicles: PNG of ids, named as the images, or COCO JSON.", metavar=_FILES)

    def source(self, camera: CameraSource) -> SensorSource | None:
        """The files as the library takes them; None where none are given."""
        from fgrecon.perception.sensor_source import SensorSource

        given = vars(self) | {"lidar_sigma": self._place_sigma()}
        made = SensorSource(camera=camera, **given)
        return made if made.given else None

    def _place_sigma(self) -> tuple[float, float]:
        """In radians and metres; 0 where it is exact."""
        if self.lidar_sigma is None:
            return (0.0, 0.0)
        numbers = parse_numbers("lidar_sigma", self.lidar_sigma, "degrees,metres: two numbers", (2,))
        return (math.radians(numbers[0]), float(numbers[1]))

    def of_video(self, video: str, camera: CameraSource) -> SensorSource | LidarTopic | None:
        """The same of a video: beside a bag what is no path is its topic."""
        from fgrecon.io.bag import is_bag
        from fgrecon.io.bag_drive import LidarTopic

        files = self.lidar is not None and any(glob(self.lidar))  # noqa: PTH207 - the pattern may be absolute
        if self.lidar is None or files or not is_bag(video):
            return self.source(camera)
        if self.masks is not None:
            raise InvalidInputError(
                "masks", self.masks, "Leave it out: beside a bag's own LiDAR nothing else is taken."
            )
        return LidarTopic(self.lidar, self.lidar_pose)
