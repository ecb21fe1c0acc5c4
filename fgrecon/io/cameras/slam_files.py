"""Cameras of calibrations for visual odometry: Kalibr's camchain, settings of ORB-SLAM, cameras of VINS (camodocal).

| from | known by | lenses that are solved |
|---|---|---|
| Kalibr | `cam0: {camera_model: ...}` | `pinhole` with `radtan`, `equidistant`, `none`; `omni` |
| ORB-SLAM | `Camera1.fx` (3), `Camera.fx` (2) | `PinHole`, `Rectified`, `KannalaBrandt8` |
| VINS | `model_type`, `projection_parameters` | `PINHOLE`, `KANNALA_BRANDT`, `MEI` |

Others (ds, eucm, fov, SCARAMUZZA, ...) are refused by name.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import Any

import numpy as np

from fgrecon.core.camera import Camera
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.lens import FISHEYE, MEI, OPENCV
from fgrecon.io.cameras.rigs import named_camera
from fgrecon.io.json_fields import Fields, within
from fgrecon.io.lens_fields import UNSOLVED, as_number

_LENS = "k1", "k2", "p1", "p2", "k3"
_KALIBR = {
    ("pinhole", "none"): OPENCV,
    ("pinhole", "radtan"): OPENCV,
    ("pinhole", "equidistant"): FISHEYE,
    ("omni", "none"): MEI,
    ("omni", "radtan"): MEI,
}
_VINS = {"PINHOLE": OPENCV, "KANNALA_BRANDT": FISHEYE, "MEI": MEI}
_ORB = {"PinHole": OPENCV, "Rectified": OPENCV, "KannalaBrandt8": FISHEYE}


def is_slam_file(data: Any) -> bool:
    """Whether the content of a YAML file is one of these."""
    return isinstance(data, Mapping) and (_kalibr(data) or "projection_parameters" in data or _orb(data) is not None)


def slam_camera(data: Mapping[str, Any], name: str | None, where: str) -> Camera:
    """The camera of one of these files.

    Args:
        name: Which camera, such as `cam1` of Kalibr or `Camera2` of ORB-SLAM; None for the only one, or the first of
            ORB-SLAM.

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
    model, lens = (_known(fields, name, _KALIBR) for name in ("camera_model", "distortion_model"))
    if (model, lens) not in _KALIBR:
        raise InvalidInputError(f"{fields.where}distortion_model", f"{lens} of {model}", UNSOLVED)
    *mirror, fx, fy, cx, cy = fields.numbers("intrinsics", (4 if model == "pinhole" else 5,)).tolist()
    numbers = [0.0] * 4 if lens == "none" else fields.numbers("distortion_coeffs", (4,)).tolist()
    width, height = fields.numbers("resolution", (2,)).astype(int).tolist()
    return _camera((fx, fy, cx, cy), [*mirror, *numbers], _KALIBR[model, lens], (width, height), fields.where)


def _of_vins(fields: Fields) -> Camera:
    model = _VINS[_known(fields, "model_type", _VINS)]
    mirror, lens, focal = (
        Fields(fields.data.get(f"{part}_parameters") or {}, f"{fields.where}{part}_parameters.")
        for part in ("mirror", "distortion", "projection")
    )
    if model == FISHEYE:  # its k2 is the factor of the angle's third power; converters write them beside the lens
        focal = Fields({**lens.data, **focal.data}, focal.where)
        names, coefficients = ("mu", "mv", "u0", "v0"), [_number(focal, name) for name in ("k2", "k3", "k4", "k5")]
    elif model == MEI:
        names = "gamma1", "gamma2", "u0", "v0"
        coefficients = [_number(mirror, "xi"), *_read(lens, _LENS[:4])]
    else:
        names, coefficients = ("fx", "fy", "cx", "cy"), _read(lens, _LENS)
    size = _size(fields, "image_width", "image_height")
    return _camera([_number(focal, name) for name in names], coefficients, model, size, fields.where)


def _of_orb(fields: Fields, name: str) -> Camera:
    if f"{name}.fx" not in fields:
        raise InvalidInputError(f"{fields.where}{name}.fx", "nothing", "Name a camera of the file, such as Camera1.")
    kind = _known(fields, "Camera.type", _ORB) if "Camera.type" in fields else "PinHole"
    focal = [_number(fields, f"{name}.{part}") for part in ("fx", "fy", "cx", "cy")]
    if kind == "KannalaBrandt8":
        coefficients = [_number(fields, f"{name}.{part}") for part in ("k1", "k2", "k3", "k4")]
    else:
        coefficients = [] if kind == "Rectified" else _read(fields, [f"{name}.{part}" for part in _LENS])
    return _camera(focal, coefficients, _ORB[kind], _size(fields, "Camera.width", "Camera.height"), fields.where)


def _camera(
    focal: Sequence[float], coefficients: list[float], model: str, size: tuple[int, int] | None, where: str
) -> Camera:
    fx, fy, cx, cy = focal
    matrix = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
    with within(where):
        return Camera(matrix, np.array(coefficients) if coefficients else None, size, distortion_model=model)


def _read(fields: Fields, names: Sequence[str]) -> list[float]:
    """The numbers of some fields; 0 for those that are absent."""
    return [_number(fields, name) if name in fields else 0.0 for name in names]


def _size(fields: Fields, width: str, height: str) -> tuple[int, int] | None:
    return (int(_number(fields, width)), int(_number(fields, height))) if width in fields else None


def _number(fields: Fields, name: str) -> float:
    whole = Fields({name: as_number(fields.data.get(name))}, fields.where)
    return float(whole.numbers(name, ()))


def _known(fields: Fields, name: str, known: Collection[Any]) -> str:
    """A lens's name; one that is not solved is refused."""
    found: str = fields.get(name, str)
    if not any(found == part for one in known for part in ([one] if isinstance(one, str) else one)):
        raise InvalidInputError(f"{fields.where}{name}", found, UNSOLVED)
    return found
