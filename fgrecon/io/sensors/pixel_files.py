"""Numbers for each pixel from files: depth maps, metres along the camera's z axis, and masks of an image's vehicles.

| depth maps' ending | content |
|---|---|
| `.png` of 16 bits | KITTI's: 256 a metre, 0 where nothing was measured; others with how many are a metre |
| `.npy`, `.npz` (`depth`) | metres |
| `.tif`, `.tiff` | metres, 32 bits |
| `.exr` | metres, the channel `Z`, `Y` or `R` |
| `.pfm` | metres |
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.arrays import Array
from fgrecon.core.checks import as_finite, as_path
from fgrecon.core.errors import InvalidInputError, MissingPackageError
from fgrecon.core.mask import Mask
from fgrecon.io.arrays import read_arrays, read_limited, read_lone_array
from fgrecon.io.boxes import coco_entries
from fgrecon.io.sensors.points import SENSORS

KITTI_PER_METRE = 256.0
"""What a metre is in KITTI's depth maps, PNG files of 16 bits."""

DEPTHS = (".png", ".npy", ".npz", ".tif", ".tiff", ".exr", ".pfm")
"""Endings of the files that are read."""

_UNITS = 1e-3, 1e6  # of a metre: kilometres to micrometres
_CHANNELS = ("Z", "Y", "R", "depth.Z", "Depth.Z")
_FIX = "Give one number for each pixel: an array (H, W)."


def read_depth(path: str | Path, per_metre: float | None = None) -> Array:
    """(H, W) depths in metres, NaN where nothing was measured.

    Args:
        per_metre: How many of the file's units a metre is: 1000 where it has millimetres. None: metres, and 256 in
            PNG files.

    Raises:
        InvalidInputError: The file cannot be read, its ending means nothing, it is no map of one number for each
            pixel, or has no depth at all; or `per_metre` is none.
        MissingPackageError: The package that reads such files is not installed.
    """
    file = as_path("depth", path)
    if per_metre is not None:
        as_per_metre(per_metre)
    ending = file.suffix.lower()
    if ending not in DEPTHS:
        raise InvalidInputError("depth", str(file), f"Give a file that ends in {', '.join(DEPTHS)}.")
    numbers = _numbers(file, ending)
    if numbers.ndim == 3 and numbers.shape[2] == 1:
        numbers = numbers[..., 0]
    if numbers.ndim != 2:
        raise InvalidInputError("depth", f"{file}: shape {numbers.shape}", _FIX)
    if numbers.dtype == np.uint8:
        fix = "Give 16 bits or more: a picture of a depth map, in 256 greys or colours, is none."
        raise InvalidInputError("depth", f"{file}: 8 bits", fix)
    if per_metre is None and numbers.dtype.kind in "iu" and ending != ".png":
        fix = (
            "Give metres, or say how many are a metre (--depth-per-metre), or that it is unknown (--depth-scale scale)."
        )
        raise InvalidInputError("depth_per_metre", f"none, for {file.name}", fix)
    factor = per_metre or (KITTI_PER_METRE if ending == ".png" else 1.0)
    depth: Array = numbers.astype(np.float64) / factor
    measured = np.isfinite(depth) & (depth > 0.0)
    if not measured.any():
        raise InvalidInputError("depth", str(file), "Give a map with a depth above 0.")
    return np.where(measured, depth, np.nan)


def as_per_metre(given: float) -> float:
    """How many units a metre is.

    Raises:
        InvalidInputError: It is no number, or of units beyond kilometres and micrometres.
    """
    fix = "Give how many of the depth files' units are a metre, such as 1000 of millimetres."
    value = float(as_finite("depth_per_metre", given, (), fix))
    if not _UNITS[0] <= value <= _UNITS[1]:
        raise InvalidInputError("depth_per_metre", value, fix)
    return value


def _numbers(path: Path, ending: str) -> NDArray[Any]:
    content = read_limited(path, "depth")
    if ending == ".npz":
        arrays = read_arrays(content, str(path), "Give an array `depth` (H, W) in metres.", ("depth",))
        if "depth" not in arrays:
            raise InvalidInputError("depth", f"{path}: no such array", "Give an array `depth` (H, W) in metres.")
        return arrays["depth"]
    if ending == ".npy":
        return read_lone_array(content, str(path), _FIX)
    image = _exr(path) if ending == ".exr" else _image(content)
    if image is None:
        raise InvalidInputError("depth", str(path), "Give an image of numbers that OpenCV reads: PNG, TIFF or PFM.")
    return image


def _image(content: bytes) -> NDArray[Any] | None:
    """The numbers of an image file as they are; None where OpenCV reads none."""
    import cv2  # on use: importing fgrecon must not import OpenCV

    try:
        image = cv2.imdecode(np.frombuffer(content, dtype=np.uint8), cv2.IMREAD_UNCHANGED) if content else None
    except cv2.error:
        return None
    return None if image is None else np.asarray(image)


def _exr(path: Path) -> NDArray[Any]:
    try:
        import OpenEXR
    except ImportError as error:
        raise MissingPackageError(SENSORS, f"Reading {path.name}") from error
    try:
        with OpenEXR.File(str(path), separate_channels=True) as file:
            channels = {name: np.array(channel.pixels) for name, channel in file.channels().items()}
    except Exception as error:  # OpenEXR promises no kind of error for damaged content
        raise InvalidInputError("depth", str(path), f"Give a whole EXR file. The reason: {error}") from error
    named = next((channels[name] for name in _CHANNELS if name in channels), None)
    if named is None:
        fix = f"Give a file with one of the channels {', '.join(_CHANNELS)}."
        raise InvalidInputError("depth", f"{path}: channels {', '.join(channels)}", fix)
    return named


MASKS = (".png", ".json")
"""Endings of files of masks."""

_IGNORED = 10_000  # the id of regions that nobody labelled, in KITTI's and MOTS's images of ids
_MASK_FIX = "Give a PNG of ids (8 or 16 bits, 0 where no vehicle is), or COCO JSON with a `segmentation` for each."


def read_masks(file: Path, image: Path, size: tuple[int, int] | None = None) -> list[Mask]:
    """The masks of an image, none where the file has none of it.

    Args:
        file: A PNG whose pixels have the id of what they show, 0 for nothing (KITTI's and MOTS's 10000 as well), or
            COCO JSON: annotations or results, with polygons or run lengths.
        image: The image's file, or its name, by which COCO's are chosen.
        size: Width and height of the image, which COCO's results without a list of images do not state.
    """
    if file.suffix.lower() == ".json":
        return _of_coco(file, image, size)
    ids = _image(read_limited(file, "masks"))
    if ids is None or ids.ndim != 2:
        value = f"{file}: no image" if ids is None else f"{file}: {ids.shape[2]} channels"
        raise InvalidInputError("masks", value, _MASK_FIX)
    return [Mask(ids == one) for one in np.unique(ids).tolist() if one not in (0, _IGNORED)]


def _of_coco(file: Path, image: Path, size: tuple[int, int] | None) -> list[Mask]:
    found, entries = [], coco_entries(file, image)
    if entries and not any("segmentation" in fields.data for fields, _ in entries):
        raise InvalidInputError(f"{entries[0][0].where}segmentation", "missing", _MASK_FIX)
    for fields, stated in entries:
        given = fields.data.get("segmentation")
        if not given:
            continue
        whole = stated or size
        try:
            if isinstance(given, Mapping):
                found.append(Mask.of_rle(given))
            elif whole is not None:
                found.append(Mask.of_polygons(given, whole))
            else:
                raise InvalidInputError("masks", f"{file}: polygons without an image's size", "Give `images` as well.")
        except InvalidInputError as error:
            raise InvalidInputError(f"{fields.where}segmentation", error.value, error.fix) from error
    return found
