"""Cameras of calibrations for visual odometry: Kalibr's camchain, settings of ORB-SLAM, cameras of VINS (camodocal).

| from | known by | lenses that are solved |
|---|---|---|
| Kalibr | `cam0: {camera_model: ...}` | `pinhole` with `radtan` or `none` |
| ORB-SLAM | `Camera1.fx` (3), `Camera.fx` (2) | `PinHole`, `Rectified` |
| VINS | `model_type`, `projection_parameters` | `PINHOLE` |

Others (omni, ds, eucm, equidistant, KannalaBrandt8, MEI, ...) are fisheyes, and are refused by name.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from fgrecon.core.camera import Camera
from fgrecon.core.errors import InvalidInputError
from fgrecon.io.cameras.camera_file_names import named_camera
from fgrecon.io.json_fields import Fields, within
from fgrecon.io.lens_fields import as_number

_SOLVED = "Only the pinhole models of OpenCV are solved. Undistort points and image, and give that camera."
_LENS = "k1", "k2", "p1", "p2", "k3"


def is_slam_file(data: Any) -> bool:
    """Whether the content of a YAML file is one of these."""
    return isinstance(data, Mapping) and (_kalibr(data) or "projection_parameters" in data or _orb(data) is not None)


def slam_camera(data: Mapping[str, Any], name: str | None, where: str) -> Camera:
    """The camera of one of these files.

    Args:
        data: The content of the file.
        name: Which camera, such as `cam1` of Kalibr or `Camera2` of ORB-SLAM; None for the only one, or the first of
            ORB-SLAM.
        where: What errors begin with.

    Raises:
        InvalidInputError: There is no such camera, its lens is none that is solved, or a field is malformed; names it.
    """
    if _kalibr(data):
        cameras = {key: value for key, value in data.items() if isinstance(value, Mapping)}
        chosen = named_camera(cameras, name, where)
        return _of_kalibr(Fields(cameras[chosen], f"{where}{chosen}."))
    if "projection_parameters" in data:
        return _of_vins(Fields(data, where))
    return _of_orb(Fields(data, where), _orb(data) or "" if name is None else name)


def _kalibr(data: Mapping[str, Any]) -> bool:
    return bool(data) and any(isinstance(value, Mapping) and "camera_model" in value for value in data.values())


def _orb(data: Mapping[str, Any]) -> str | None:
    return next((name for name in ("Camera1", "Camera") if f"{name}.fx" in data), None)


def _of_kalibr(fields: Fields) -> Camera:
    _check(fields, "camera_model", ("pinhole",))
    _check(fields, "distortion_model", ("radtan", "none"))
    fx, fy, cx, cy = fields.numbers("intrinsics", (4,))
    lens = fields.numbers("distortion_coeffs", (4,)) if fields.data["distortion_model"] == "radtan" else None
    width, height = fields.numbers("resolution", (2,)).astype(int).tolist()
    with within(fields.where):
        return Camera(np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]]), lens, (width, height))


def _of_vins(fields: Fields) -> Camera:
    _check(fields, "model_type", ("PINHOLE",))
    focal = Fields(fields.get("projection_parameters", dict), f"{fields.where}projection_parameters.")
    lens = Fields(fields.data.get("distortion_parameters") or {}, f"{fields.where}distortion_parameters.")
    return _camera(focal, lens, "", fields, ("image_width", "image_height"))


def _of_orb(fields: Fields, name: str) -> Camera:
    if f"{name}.fx" not in fields:
        raise InvalidInputError(f"{fields.where}{name}.fx", "nothing", "Name a camera of the file, such as Camera1.")
    if "Camera.type" in fields:
        _check(fields, "Camera.type", ("PinHole", "Rectified"))
    rectified = fields.data.get("Camera.type") == "Rectified"
    lens = Fields({}, fields.where) if rectified else fields
    return _camera(fields, lens, f"{name}.", fields, ("Camera.width", "Camera.height"))


def _camera(focal: Fields, lens: Fields, before: str, sized: Fields, size: tuple[str, str]) -> Camera:
    """The camera of fields `fx`, `fy`, `cx`, `cy` and of a lens, whose names have something before them."""
    fx, fy, cx, cy = (_number(focal, f"{before}{name}") for name in ("fx", "fy", "cx", "cy"))
    numbers = [_number(lens, f"{before}{name}") if f"{before}{name}" in lens else 0.0 for name in _LENS]
    known = (int(_number(sized, size[0])), int(_number(sized, size[1]))) if size[0] in sized else None
    with within(sized.where):
        return Camera(np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]]), np.array(numbers), known)


def _number(fields: Fields, name: str) -> float:
    whole = Fields({name: as_number(fields.data.get(name))}, fields.where)
    return float(whole.numbers(name, ()))


def _check(fields: Fields, name: str, solved: tuple[str, ...]) -> None:
    """Refuse a lens that is not solved."""
    if (found := fields.get(name, str)) not in solved:
        raise InvalidInputError(f"{fields.where}{name}", found, _SOLVED)
