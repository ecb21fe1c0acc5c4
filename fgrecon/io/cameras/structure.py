"""Cameras of structure from motion: COLMAP's `cameras.txt` and `cameras.bin`, nerfstudio's `transforms.json`.

Both count pixels from the corner of the image: the centre of the first one is at (0.5, 0.5), in fgrecon at (0, 0).
Lenses that are not solved are refused by name. Poses of nerfstudio are of a camera that looks along -z, with y up.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.camera import Camera
from fgrecon.core.checks import as_rigid
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.lens import FISHEYE, OPENCV
from fgrecon.io.cameras.rigs import MountedCamera, named_camera
from fgrecon.io.files import filled_lines, read_text
from fgrecon.io.json_fields import Fields, within

_HALF = 0.5  # pixels: the centre of COLMAP's first pixel
_FIX = "Give COLMAP's file of cameras as it wrote it."
_SOLVED = "It is not solved: undistort the images (colmap image_undistorter) and give that camera."
_BACK_UP = np.diag([1.0, -1.0, -1.0, 1.0])
"""From a camera that looks along z, y down, to one that looks along -z, y up."""

_MODELS = {
    "SIMPLE_PINHOLE": ("f", "cx", "cy"),
    "PINHOLE": ("fx", "fy", "cx", "cy"),
    "SIMPLE_RADIAL": ("f", "cx", "cy", "k1"),
    "RADIAL": ("f", "cx", "cy", "k1", "k2"),
    "OPENCV": ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2"),
    "FULL_OPENCV": ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"),
}
_NUMBERS = {0: "SIMPLE_PINHOLE", 1: "PINHOLE", 2: "SIMPLE_RADIAL", 3: "RADIAL", 4: "OPENCV", 6: "FULL_OPENCV"}
_NUMBERS |= {5: "OPENCV_FISHEYE", 8: "SIMPLE_RADIAL_FISHEYE", 9: "RADIAL_FISHEYE"}
_FISHEYES = {
    "OPENCV_FISHEYE": ("fx", "fy", "cx", "cy", "k1", "k2", "k3", "k4"),
    "SIMPLE_RADIAL_FISHEYE": ("f", "cx", "cy", "k1"),
    "RADIAL_FISHEYE": ("f", "cx", "cy", "k1", "k2"),
}
_UNSOLVED = {7: ("FOV", 5), 10: ("THIN_PRISM_FISHEYE", 12)}
"""Names and numbers of parameters."""
_MODELS |= _FISHEYES
_LENS = "k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"
_FISHEYE_LENS = "k1", "k2", "k3", "k4"


@dataclass(frozen=True)
class _Line:
    """A camera of COLMAP: model, width and height, parameters."""

    model: str
    size: tuple[int, int]
    numbers: tuple[float, ...]


def is_colmap(path: Path) -> bool:
    """Whether a file is COLMAP's by its name."""
    return path.name in ("cameras.txt", "cameras.bin")


def colmap_camera(path: Path, image: str | None, name: str | None) -> Camera:
    """A camera of COLMAP.

    Args:
        image: File name of the photograph; `images.txt` beside tells which camera took it.
        name: Number of the camera, or None.

    Raises:
        InvalidInputError: There is no such camera, its model is not solved, or the file is malformed; names it.
    """
    cameras = _of_text(path) if path.suffix == ".txt" else _of_bytes(path)
    beside = path.with_name("images.txt")
    if name is None and image is not None and beside.is_file():
        name = _camera_of(beside, image)
    chosen = named_camera(cameras, name, f"{path}: ")
    line, where = cameras[chosen], f"{path}: {chosen}: "
    if line.model not in _MODELS:
        raise InvalidInputError(f"{where}model", line.model, _SOLVED)
    parts = _MODELS[line.model]
    if len(line.numbers) != len(parts):
        raise InvalidInputError(where.rstrip(": "), f"{len(line.numbers)} numbers", f"Give {' '.join(parts)}.")
    return _camera(dict(zip(parts, line.numbers, strict=True)), line.model, line.size, where)


def _camera(found: Mapping[str, float], model: str, size: tuple[int, int], where: str) -> Camera:
    fx, fy = found.get("fx", found.get("f")), found.get("fy", found.get("f"))
    matrix = np.array([[fx, 0.0, found["cx"] - _HALF], [0.0, fy, found["cy"] - _HALF], [0.0, 0.0, 1.0]])
    lens, parts = (FISHEYE, _FISHEYE_LENS) if model in _FISHEYES else (OPENCV, _LENS)
    with within(where):
        return Camera(matrix, np.array([found.get(part, 0.0) for part in parts]), size, distortion_model=lens)


def _of_text(path: Path) -> dict[str, _Line]:
    found = {}
    for place, line in filled_lines(path, "camera", _FIX):
        words = line.split()
        if words[0].startswith("#"):
            continue
        try:
            size = int(words[2]), int(words[3])
            found[words[0]] = _Line(words[1], size, tuple(map(float, words[4:])))
        except (IndexError, ValueError):
            raise InvalidInputError(place, line[:80], _FIX) from None
    return found


def _of_bytes(path: Path) -> dict[str, _Line]:
    try:
        content = path.read_bytes()
        (count,), at, found = struct.unpack_from("<Q", content), 8, {}
        for _ in range(count):
            camera, model, width, height = struct.unpack_from("<iiQQ", content, at)
            name = _NUMBERS.get(model, "")
            name, size = (name, len(_MODELS[name])) if name else _UNSOLVED[model]
            numbers = struct.unpack_from(f"<{size}d", content, at + 24)
            found[str(camera)], at = _Line(name, (width, height), numbers), at + 24 + 8 * size
    except OSError as error:
        raise InvalidInputError("camera", str(path), f"Give a file that can be read ({error.strerror}).") from error
    except (struct.error, KeyError) as error:
        raise InvalidInputError(str(path), f"malformed: {error}", _FIX) from None
    return found


def _camera_of(path: Path, image: str) -> str | None:
    """The camera that took an image; None where the file does not know it."""
    stem = Path(image).stem
    for line in read_text(path, "camera", _FIX).splitlines():
        words = line.split()
        if len(words) == 10 and not words[0].startswith("#") and Path(words[9]).stem == stem:
            return words[8]
    return None


def is_nerfstudio(data: Any) -> bool:
    """Whether the content of a JSON file is nerfstudio's."""
    frames = data.get("frames") if isinstance(data, Mapping) else None
    return isinstance(frames, list) and all(isinstance(f, Mapping) and "transform_matrix" in f for f in frames)


def nerfstudio_camera(data: Mapping[str, Any], image: str | None, name: str | None, where: str) -> MountedCamera:
    """The camera of nerfstudio's file, and its pose where an image is named.

    Args:
        name: Name of an image after the file, or None.

    Raises:
        InvalidInputError: The lens is none that is solved, images have cameras of their own and none is named, or a
            field is missing or malformed; names it.
    """
    wanted = name or image
    frames = {Path(str(f.get("file_path"))).stem: (i, f) for i, f in enumerate(data["frames"])}
    shown = frames.get(Path(wanted).stem) if wanted is not None else None
    if name is not None and shown is None:
        raise InvalidInputError(f"{where}frames", name, "Name an image of the file.")
    place, own = (where, {}) if shown is None else (f"{where}frames[{shown[0]}].", shown[1])
    fields = Fields({**data, **own}, place)
    if "fl_x" not in fields and shown is None:
        fix = "Name the photograph, or an image after the file."
        if not any("fl_x" in frame for _, frame in frames.values()):
            fix = "Give fl_x, fl_y, cx, cy, w and h: an angle of the view alone has no pixels."
        raise InvalidInputError(f"{where}fl_x", "none for all images", fix)
    default = "OPENCV_FISHEYE" if fields.data.get("is_fisheye") else "OPENCV"  # instant-ngp names no model
    model = fields.data.get("camera_model", default)
    if not isinstance(model, str) or model not in _MODELS or (model not in _FISHEYES and fields.data.get("k4")):
        raise InvalidInputError(
            f"{place}{'k4' if isinstance(model, str) and model in _MODELS else 'camera_model'}", model, _SOLVED
        )
    numbers = {part: float(fields.numbers(part, ())) for part in ("fl_x", "fl_y", "cx", "cy", "w", "h")}
    numbers |= {part: float(fields.numbers(part, ())) for part in _LENS if part in fields}
    numbers |= {"fx": numbers["fl_x"], "fy": numbers["fl_y"]}
    camera = _camera(numbers, model, (int(numbers["w"]), int(numbers["h"])), place)
    return MountedCamera(camera, world_T_camera=None if shown is None else _pose(fields))


def _pose(fields: Fields) -> NDArray[np.float64]:
    """(4, 4) world_T_camera of an image."""
    name = f"{fields.where}transform_matrix"
    return as_rigid(name, fields.numbers("transform_matrix", (4, 4))) @ _BACK_UP
