"""What the command line says of a whole run: prior, ground, size, options, and the camera. Loads no solver."""

from __future__ import annotations

import os
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgrecon.cli.common import ground_plane, parse_crop, parse_numbers
from fgrecon.core.camera import Camera, Ground
from fgrecon.core.choices import BoxModel
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.options import BoxOptions, KeypointOptions, Options
from fgrecon.core.shape_prior import ShapePrior
from fgrecon.core.size_prior import SizePrior
from fgrecon.core.size_prior import size_prior as parse_size
from fgrecon.io.cameras import MountedCamera, read_camera
from fgrecon.io.catalogue import load_prior, shipped_priors
from fgrecon.io.integrity import file_hash
from fgrecon.io.kitti_calibration import read_calibration

__all__ = ["CameraSource", "Settings", "content_hash", "plain_camera", "plain_settings"]


@dataclass(frozen=True)
class Settings:
    """What holds for every vehicle of a run.

    Attributes:
        prior: The shape prior.
        ground: The ground plane, or None.
        size_prior: How large vehicles are, or None.
        options: How they are solved.
        prior_file: Where the prior is from; None for a shipped one.
    """

    prior: ShapePrior
    ground: Ground | None
    size_prior: SizePrior | None
    options: Options
    prior_file: Path | None = None

    @classmethod
    def of(
        cls, prior: str, ground: str | None, camera_height: float | None, size_prior: str | None, options: Options
    ) -> Settings:
        """The settings as the command line gives them.

        Raises:
            InvalidInputError: A value names nothing, or both a plane and a height are given.
        """
        plane = ground_plane(ground, camera_height)
        return cls(
            prior=load_prior(prior),
            ground=None if plane is None else plane[0],
            size_prior=None if size_prior is None else parse_size(size_prior),
            options=options,
            prior_file=None if prior in shipped_priors() else Path(prior).resolve(),
        )


@dataclass(frozen=True)
class CameraSource:
    """The camera as the command line gives it; every part may be None.

    Attributes:
        calib: KITTI calibration file.
        intrinsics: `fx,fy,cx,cy`.
        distortion: OpenCV's coefficients, separated by commas.
        image: (H, W, 3) photograph, which tells the image's size.
        file: Calibration file of any format, as `fgrecon.io.cameras.read_camera` takes it.
        own: The camera that the photograph's file tells (`fgrecon.io.exif`), where nothing else does.
        crop: `left,top[,width,height]`: the image is a part of another of that size, and what is said of the camera
            holds for that one.
    """

    calib: Path | None
    intrinsics: str | None
    distortion: str | None
    image: NDArray[np.uint8] | None
    file: str | None = None
    own: Camera | None = None
    crop: str | None = None

    @property
    def given(self) -> bool:
        """Whether the command line says which camera it is."""
        return any(part is not None for part in (self.calib, self.intrinsics, self.file))

    def camera(self, image: str | None = None) -> tuple[Camera | None, NDArray[np.float64] | None]:
        """The camera, and where KITTI's label frame lies from it; None where the command line does not say.

        Args:
            image: File name of the photograph, which tells the camera where a calibration has several.

        Raises:
            InvalidInputError: Several ways are used, or a value is no camera.
        """
        if self.calib is not None and self.intrinsics is not None:
            raise InvalidInputError("intrinsics", self.intrinsics, "Give either --calib or --intrinsics.")
        mounted = self.mounted(image)
        if mounted is not None:
            return mounted.camera, mounted.label_offset
        if self.intrinsics is None:
            return None, None
        wanted = "fx,fy,cx,cy: four numbers in pixels"
        return Camera.of(parse_numbers("intrinsics", self.intrinsics, wanted, (4,))), None

    def mounted(self, image: str | None = None) -> MountedCamera | None:
        """The camera of the command line's calibration file and what the file says beside it; None without a file.

        Args:
            image: File name of the photograph.

        Raises:
            InvalidInputError: Another way is used as well, or the file is none.
        """
        if self.file is not None and (self.calib is not None or self.intrinsics is not None):
            raise InvalidInputError("camera", self.file, "Give either --camera, --calib or --intrinsics.")
        if self.calib is not None:
            calibration = read_calibration(self.calib)
            return MountedCamera(calibration.camera, calibration.label_offset)
        return None if self.file is None else read_camera(self.file, image)

    def assumed(self, size: tuple[int, int]) -> Camera:
        """The photograph's own camera, or one of unknown focal length; of a part, that of the whole image.

        Args:
            size: (width, height) of the photograph, pixels.
        """
        return self.own or Camera.of_unknown(*self.whole(size))

    def whole(self, size: tuple[int, int]) -> tuple[int, int]:
        """(width, height) of the image whose camera is meant, from the photograph's own.

        Raises:
            InvalidInputError: The photograph is a part of an image, and nobody says how large that one is.
        """
        part = None if self.crop is None else parse_crop(self.crop)
        if part is None:
            return size
        if part.whole is None:
            raise InvalidInputError("crop", self.crop, "Give left,top,width,height, or the camera.")
        return part.whole

    def complete(self, camera: Camera, *, declared: bool) -> Camera:
        """The camera with the distortion of the command line, of the part that the photograph is, of its size.

        Args:
            camera: The camera so far.
            declared: Whether the user declared its image's size, if it has one; else the photograph knows better (some
                of KITTI's images are cropped).

        Raises:
            InvalidInputError: The distortion is none, the photograph is no such part, or it has another size than was
                declared.
        """
        if self.distortion is not None:
            wanted = "4, 5, 8, 12 or 14 numbers in OpenCV's order: k1,k2,p1,p2[,k3,...]"
            numbers = parse_numbers("distortion", self.distortion, wanted, (4, 5, 8, 12, 14))
            camera = replace(camera, distortion=np.array(numbers))
        size = None if self.image is None else (self.image.shape[1], self.image.shape[0])
        if self.crop is not None:
            part = parse_crop(self.crop)
            whole = camera if part.whole is None else replace(camera, image_size=part.whole)
            return whole.cropped(part.left, part.top, *(size or ()))
        if size is None:
            return camera
        if declared and camera.image_size not in (None, size):
            raise InvalidInputError("image", f"{size} pixels", f"Give the image of {camera.image_size} pixels.")
        assert self.image is not None
        return camera.with_size_of(self.image)


def plain_settings(settings: Settings) -> dict[str, Any]:
    """What held for all vehicles of a run, for JSON; with `prior_file` surfaces can be made again."""
    return {
        "prior": settings.prior.name,
        "prior_file": None if settings.prior_file is None else str(settings.prior_file),
        "ground": _plain_ground(settings.ground),
        "size_prior": _plain_size(settings.size_prior),
        "strategy": settings.options.strategy.name.value,
        "box_model": settings.options.box.model.value,
        **({} if settings.options.traffic is None else {"traffic": settings.options.traffic.value}),
        **_changed("keypoints", settings.options.keypoints, KeypointOptions()),
        **_changed("boxes", replace(settings.options.box, model=BoxModel.SURFACE), BoxOptions()),
    }


def _changed(name: str, given: KeypointOptions | BoxOptions, default: KeypointOptions | BoxOptions) -> dict[str, Any]:
    """What is assumed of the keypoint detector, or of boxes, where that is not the default."""
    told = {entry.name: getattr(given, entry.name) for entry in fields(given)}
    changed = {entry: value for entry, value in told.items() if value != getattr(default, entry)}
    return {name: changed} if changed else {}


def content_hash(path: Path | None) -> str | None:
    """The hash of a file's content; None for what is no file."""
    return file_hash(path) if path is not None and os.path.isfile(path) else None  # noqa: PTH113 - raises for no name


def _plain_ground(ground: Ground | None) -> dict[str, Any] | None:
    """A ground plane for JSON."""
    return None if ground is None else {"normal": ground.normal.tolist(), "distance": ground.distance}


def _plain_size(size: SizePrior | None) -> dict[str, Any] | None:
    """A size prior for JSON."""
    return None if size is None else {"name": size.name, "mean": size.mean.tolist(), "sigma": size.sigma.tolist()}


def plain_camera(camera: Camera) -> dict[str, Any]:
    """A camera for JSON."""
    return {
        "matrix": camera.matrix.tolist(),
        "distortion": None if camera.distortion is None else camera.distortion.tolist(),
        "image_size": camera.image_size,
        **({"focal_sigma": camera.focal_sigma} if camera.focal_sigma else {}),
    }
