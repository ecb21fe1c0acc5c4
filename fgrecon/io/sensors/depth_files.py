"""Depth maps from files: metres along the camera's z axis for each pixel.

| ending | content |
|---|---|
| `.png` of 16 bits | KITTI's: 256 a metre, 0 where nothing was measured; others with how many are a metre |
| `.npy`, `.npz` (`depth`) | metres |
| `.tif`, `.tiff` | metres, 32 bits |
| `.exr` | metres, the channel `Z`, `Y` or `R` |
| `.pfm` | metres |
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.arrays import Array
from fgrecon.core.checks import as_path
from fgrecon.core.errors import InvalidInputError, MissingPackageError
from fgrecon.io.arrays import read_arrays, read_limited, read_lone_array
from fgrecon.io.sensors.points import SENSORS

KITTI_PER_METRE = 256.0
"""What a metre is in KITTI's depth maps, PNG files of 16 bits."""

DEPTHS = (".png", ".npy", ".npz", ".tif", ".tiff", ".exr", ".pfm")
"""Endings of the files that are read."""

_CHANNELS = ("Z", "Y", "R", "depth.Z", "Depth.Z")
_FIX = "Give one number for each pixel: an array (H, W)."


def read_depth(path: str | Path, per_metre: float | None = None) -> Array:
    """(H, W) depths in metres, NaN where nothing was measured.

    Args:
        per_metre: How many of the file's units a metre is: 1000 where it has millimetres. None: metres, and 256 in
            PNG files.

    Raises:
        InvalidInputError: The file cannot be read, its ending means nothing, it is no map of one number for each
            pixel, or has no depth at all.
        MissingPackageError: The package that reads such files is not installed.
    """
    file = as_path("depth", path)
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
        fix = "Give metres, or say how many are a metre (`per_metre`), or that it is unknown (--depth-scale scale)."
        raise InvalidInputError("depth_per_metre", f"none, for {file.name}", fix)
    factor = per_metre or (KITTI_PER_METRE if ending == ".png" else 1.0)
    depth: Array = numbers.astype(np.float64) / factor
    measured = np.isfinite(depth) & (depth > 0.0)
    if not measured.any():
        raise InvalidInputError("depth", str(file), "Give a map with a depth above 0.")
    return np.where(measured, depth, np.nan)


def _numbers(path: Path, ending: str) -> NDArray[Any]:
    content = read_limited(path, "depth")
    if ending == ".npz":
        arrays = read_arrays(content, str(path), "Give an array `depth` (H, W) in metres.", ("depth",))
        if "depth" not in arrays:
            raise InvalidInputError("depth", f"{path}: no such array", "Give an array `depth` (H, W) in metres.")
        return arrays["depth"]
    if ending == ".npy":
        return read_lone_array(content, str(path), _FIX)
    return _exr(path) if ending == ".exr" else _image(content, path)


def _image(content: bytes, path: Path) -> NDArray[Any]:
    import cv2  # on use: importing fgrecon must not import OpenCV

    try:
        image = cv2.imdecode(np.frombuffer(content, dtype=np.uint8), cv2.IMREAD_UNCHANGED) if content else None
    except cv2.error:
        image = None
    if image is None:
        raise InvalidInputError("depth", str(path), "Give an image of numbers that OpenCV reads: PNG, TIFF or PFM.")
    return np.asarray(image)


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
