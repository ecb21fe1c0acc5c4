"""LiDAR sweeps of a data set as evidence: the one that belongs to an image, in the camera's frame."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.errors import InvalidInputError
from fgrecon.io.datasets import CameraImage, is_data_set, open_sequence
from fgrecon.io.frame_names import of_one_image


@dataclass(frozen=True)
class DataSetSweeps:
    """The sweeps of a sequence, or of what a camera of it shows."""

    images: Mapping[str, CameraImage]  # those with a sweep whose file is there, by their names

    @classmethod
    def of_source(cls, given: str | None) -> DataSetSweeps | None:
        """Those of what is given, such as `FOLDER#SEQUENCE/CAMERA`; None where it is no data set.

        Raises:
            InvalidInputError: There is none, images of two cameras have the same names, or a file is malformed.
        """
        if given is None or not is_data_set(given):
            return None
        found, camera = open_sequence(given)
        images = found.images if camera is None else found.of_camera(camera)
        swept = [image for image in images if image.sweep is not None and image.sweep.path.is_file()]
        if not swept:
            raise InvalidInputError("lidar", given, f"Give the sweeps of {found.name} there.")
        names = {image.path.name: image for image in swept}
        if len(names) < len(swept):
            fix = f"Name a camera, such as {given.partition('#')[0]}#{found.name}/{found.cameras[0]}."
            raise InvalidInputError("lidar", given, fix)
        return cls(names)

    def of(self, image: str) -> tuple[Path, NDArray[np.float64]] | None:
        """The file of an image's sweep and (4, 4) from its points' frame to the camera's; None where there is none."""
        names = of_one_image(self.images, image)
        found = self.images[names.pop()] if len(names) == 1 else None
        if found is None or found.sweep is None or (place := found.camera_T_points) is None:
            return None
        return found.sweep.path, place
