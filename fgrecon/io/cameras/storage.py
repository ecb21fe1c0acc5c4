"""Calibrations as ROS (`camera_info` in YAML) and OpenCV (`FileStorage` in YAML, XML or JSON) write them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np
import yaml
from numpy.typing import NDArray

from fgrecon.core.camera import Camera
from fgrecon.core.errors import InvalidInputError
from fgrecon.io.files import read_text
from fgrecon.io.json_fields import Fields, numbers, within
from fgrecon.io.lens_fields import as_number, check_unused, listed_numbers, read_lens, read_size

_MATRIX = "camera_matrix", "Camera_Matrix", "cameraMatrix", "K", "k", "intrinsic_matrix"
_PROJECTION = "projection_matrix", "P", "p"
_PARTS = "fx", "fy", "cx", "cy"
_MOST = 100_000
_BAD_YAML = yaml.YAMLError, ValueError, TypeError, AttributeError, KeyError, IndexError, RecursionError


class _Loader(yaml.SafeLoader):  # type: ignore[misc]  # no types are installed
    """Plain values, and OpenCV's matrices as mappings."""


for _name in ("opencv-matrix", "opencv-nd-matrix"):
    _Loader.add_constructor(
        f"tag:yaml.org,2002:{_name}", lambda loader, node: loader.construct_mapping(node, deep=True)
    )


def read_storage(path: Path) -> Any:
    """The content of a YAML or XML file as JSON would have it."""
    text = read_text(path, "camera")
    if path.suffix.lower() == ".xml":
        try:
            root = ET.fromstring(text)  # noqa: S314  # expat bounds what entities may expand to
        except (ET.ParseError, ValueError) as error:
            raise InvalidInputError(str(path), str(error), "Give an XML file of OpenCV's FileStorage.") from error
        return {child.tag: _of_xml(child) for child in root}
    # OpenCV's first line is no YAML, and its matrices have a type of their own.
    text = text.partition("\n")[2] if text.startswith("%YAML:") else text
    try:
        messages = [_bounded(m, _MOST) for m in yaml.load_all(text, Loader=_Loader) if m is not None]
    except _BAD_YAML as error:
        raise InvalidInputError(str(path), str(error), "Give a YAML file of ROS or OpenCV.") from error
    # `ros2 topic echo` ends each message with `---`: the camera is that of all of them.
    calibrations = [{k: v for k, v in m.items() if k != "header"} if isinstance(m, dict) else m for m in messages]
    if any(other != calibrations[0] for other in calibrations[1:]):
        raise InvalidInputError(str(path), f"{len(messages)} messages that differ", "Give the message of one camera.")
    return messages[0] if messages else None


def storage_camera(data: Mapping[str, Any], where: str, name: str | None = None) -> Camera:
    """The camera of a calibration in ROS's or OpenCV's names.

    Args:
        name: `projection_matrix` for the camera of ROS's rectified image; None for that of the image as it was taken.

    Raises:
        InvalidInputError: A field is missing or malformed, or the lens is none that is solved; names the field.
    """
    fields = Fields(data, where)
    _check_whole_image(fields)
    rectified = name in _PROJECTION
    if name is not None and not rectified:
        fix = f"Give {_PROJECTION[0]} for the rectified image, or nothing for the image as it was taken."
        raise InvalidInputError(f"{where}camera", name, fix)
    matrix = _matrix(fields, _PROJECTION if rectified else _MATRIX, (3, 4) if rectified else (3, 3))[:, :3]
    check_unused(fields, (*_MATRIX, *_PROJECTION))
    lens, size = read_lens(fields), read_size(fields)
    with within(where):
        return Camera(matrix, image_size=size, **({} if rectified else lens))


def _bounded(content: Any, most: int) -> Any:
    """The content, if it holds at most so many values: a few lines of aliases of aliases stand for billions."""
    left, waiting = most, [content]
    while waiting:
        left -= 1
        if left < 0:
            raise ValueError(f"more than {most} values")
        value = waiting.pop()
        waiting.extend(value.values() if isinstance(value, dict) else value if isinstance(value, list) else ())
    return content


def _of_xml(element: ET.Element) -> Any:
    """An element as YAML would have it: a mapping of what is in it, else its numbers or its text."""
    if len(element):
        return {child.tag: _of_xml(child) for child in element}
    words = (element.text or "").split()
    try:
        values = [float(word) for word in words]
    except ValueError:
        return (element.text or "").strip()
    return values[0] if len(values) == 1 else values


def _first(fields: Fields, names: Iterable[str]) -> str | None:
    return next((name for name in names if name in fields), None)


def _matrix(fields: Fields, names: tuple[str, ...], shape: tuple[int, int]) -> NDArray[np.float64]:
    field = _first(fields, names)
    if field is None and names is _MATRIX and any(part in fields for part in _PARTS):
        fx, fy, cx, cy = (numbers(fields.data.get(part), (), f"{fields.where}{part}") for part in _PARTS)
        return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
    if field is None:
        known = "camera_matrix" if names is _MATRIX else names[0]
        raise InvalidInputError(f"{fields.where}{known}", "nothing", "Give a calibration of ROS or OpenCV.")
    listed, place = listed_numbers(fields, field)
    values = [as_number(item) for item in listed]
    if any(isinstance(row, list) for row in values):
        return numbers(values, shape, place)
    return numbers(values, (shape[0] * shape[1],), place).reshape(shape)


def _check_whole_image(fields: Fields) -> None:
    """Refuse calibrations that are of a larger image than the camera gives."""
    roi = fields.data.get("roi")
    parts = {f"roi.{name}": roi.get(name) for name in ("x_offset", "y_offset")} if isinstance(roi, Mapping) else {}
    for name, value in {**{n: fields.data.get(n) for n in ("binning_x", "binning_y")}, **parts}.items():
        least = 1 if name.startswith("binning") else 0
        if isinstance(value, int | float) and value > least:
            raise InvalidInputError(f"{fields.where}{name}", value, "Give the calibration of the image as it is.")
