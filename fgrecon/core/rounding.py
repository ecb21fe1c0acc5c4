"""Rounding of results in compact JSON: to more digits than anybody measures, far fewer than doubles have."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import numpy as np

from fgrecon.core.serialise import plain

DECIMALS: Mapping[str, int] = {
    "camera_T_object": 9,
    "coefficients": 9,
    "offsets": 6,
    "wireframe": 6,
    "wireframe_uv": 3,
    "box_size": 6,
    "weights": 6,
    "visibility": 6,
    "facing_probability": 9,
    "box_excess": 6,
    "milliseconds": 3,
}
"""Digits behind the point, by field: nanometres of the pose, micrometres of keypoints, thousandths of pixels."""

SIGNIFICANT: Mapping[str, int] = {
    "sigmas": 6,
    "pose_covariance": 6,
    "coefficients_covariance": 6,
    "keypoint_covariance": 4,
    "size_covariance": 6,
    "energies": 9,
    "excess": 9,
    "probability": 6,
    "graph_gain": 9,
}
"""Significant digits of fields whose numbers are of any size."""


def rounded(name: str, value: Any) -> Any:
    """The plain value of a field (`fgrecon.core.serialise.plain`) with the digits that the field keeps.

    Texts, integers and what the tables do not name stay as they are; dictionaries inside lists go by their own names.
    """
    if name in DECIMALS:
        return _each(partial(round, ndigits=DECIMALS[name]), value)
    if name in SIGNIFICANT:
        return _each(partial(_significant, SIGNIFICANT[name]), value)
    if isinstance(value, list) and value and isinstance(value[0], dict):
        return [{key: rounded(key, item) for key, item in entry.items()} for entry in value]
    return value


def rounded_plain(name: str, value: Any) -> Any:
    """`rounded` of what is not plain yet; arrays as a whole, of which results have most."""
    digits = DECIMALS.get(name)
    cut = digits is not None or name in SIGNIFICANT
    is_array = isinstance(value, np.ndarray) and value.dtype.kind == "f" and value.ndim > 0 and value.size > 0
    if not (cut and is_array and np.isfinite(value).all()):
        return rounded(name, plain(value))
    numbers = value.ravel().tolist()
    if digits is not None:
        found = [round(number, digits) for number in numbers]
    else:
        words = " ".join([f"%.{SIGNIFICANT[name]}g"] * len(numbers)) % tuple(numbers)
        found = [float(word) for word in words.split()]
    for count in value.shape[:0:-1]:
        found = [found[start : start + count] for start in range(0, len(found), count)]
    return found


def _each(cut: Callable[[float], float], value: Any) -> Any:
    if isinstance(value, float):
        return cut(value)
    if isinstance(value, list):
        return [cut(item) if type(item) is float else _each(cut, item) for item in value]
    if isinstance(value, dict):
        return {key: _each(cut, item) for key, item in value.items()}
    return value


def _significant(digits: int, value: float) -> float:
    return float(f"{value:.{digits}g}")
