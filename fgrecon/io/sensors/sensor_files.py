"""A sensor's file that belongs to an image: a file alone, one of a folder or pattern, or a data set's LiDAR sweep."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from glob import glob
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.errors import InvalidInputError
from fgrecon.io.datasets import CameraImage, is_data_set, open_sequence
from fgrecon.io.source_frames import of_one_image


@dataclass(frozen=True)
class SensorFiles:
    """The files of a sensor."""

    field: str  # what an error calls them
    given: str  # a file, a folder, or a pattern such as `lidar/*.npz`
    endings: tuple[str, ...]  # of the files that count, in small letters

    @cached_property
    def _files(self) -> dict[str, Path]:
        """The files of a folder or of a pattern by their names without ending."""
        folder = Path(self.given)
        of_pattern = [] if folder.is_dir() else glob(self.given)  # noqa: PTH207 - the pattern may be absolute
        paths = folder.iterdir() if folder.is_dir() else map(Path, of_pattern)
        longest_first = sorted(self.endings, key=len, reverse=True)
        found: dict[str, Path] = {}
        for path in sorted(paths):
            ending = next((one for one in longest_first if path.name.lower().endswith(one)), None)
            if ending is None or not path.is_file():
                continue
            stem = path.name[: -len(ending)]
            if stem in found:
                fix = "Give one file for each image: a pattern chooses among endings."
                raise InvalidInputError(self.field, f"{found[stem].name} and {path.name}", fix)
            found[stem] = path
        if not found and not (folder.is_dir() or of_pattern):
            fix = "Give a file or a folder that exists, or a pattern of such files."
            raise InvalidInputError(self.field, self.given, fix)
        if not found:
            raise InvalidInputError(self.field, self.given, f"Give files that end in {', '.join(self.endings)}.")
        return found

    @property
    def alone(self) -> bool:
        """Whether it is one file, which is of whatever image there is."""
        return Path(self.given).is_file()

    def all(self) -> list[Path]:
        """All of them."""
        return [Path(self.given)] if self.alone else list(self._files.values())

    def of(self, image: str) -> Path | None:
        """The file of an image; None where there is none.

        Args:
            image: The image's name, with its ending or without; numbers may differ by zeros before them.

        Raises:
            InvalidInputError: There are no files at all, or several are of this image.
        """
        if self.alone:
            return Path(self.given)
        names = of_one_image(self._files, image)
        if len(names) > 1:
            raise InvalidInputError(self.field, f"{', '.join(sorted(names))} for {image}", "Give one for each image.")
        return self._files[names.pop()] if names else None


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
