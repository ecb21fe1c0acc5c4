"""Whether the arrays of a result that was read fit one another: as many rows as keypoints, no index beyond them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from factors.checks import has_shape, shape_words
from fgrecon.core.errors import InvalidInputError

__all__ = ["check_shapes"]

_FIX = "Give the result as fgrecon wrote it"

_SHAPES: Mapping[str, tuple[int | str | None, ...]] = {
    "camera_T_object": (4, 4),
    "coefficients": ("N",),
    "offsets": ("K", 3),
    "wireframe": ("K", 3),
    "wireframe_uv": ("K", 2),
    "keypoints": ("K", 3),
    "projections": ("K", 2),
    "box_size": (3,),
    "weights": ("K",),
    "sigmas": ("K",),
    "visibility": ("K",),
    "pose_covariance": (6, 6),
    "coefficients_covariance": ("N", "N"),
    "keypoint_covariance": ("K", 3, 3),
    "size_covariance": (3, 3),
    "surface_vertices": (None, 3),
    "surface_faces": (None, 3),
}
"""Of the arrays of results, alternatives and steps by name: K keypoints, N coefficients, None is any number."""


def check_shapes(values: Mapping[str, Any]) -> None:
    """Check the fields of a `Reconstruction`.

    Raises:
        InvalidInputError: A field has another shape than the others, or an index of none of them.
    """
    names = values["keypoint_names"]
    if not all(isinstance(name, str) for name in names):
        raise InvalidInputError("keypoint_names", names, f"{_FIX}: names are texts.")
    lengths = {"K": len(names), "N": np.size(values["coefficients"])}
    _check("", values, lengths)
    for name in ("pose_covariance", "size_covariance"):
        if values.get(name) is not None and not np.isfinite(values[name]).all():
            raise InvalidInputError(name, "not finite", f"{_FIX}: finite numbers, or null.")
    for kind in ("alternatives", "history"):
        for number, entry in enumerate(values.get(kind, ())):
            _check(f"{kind}[{number}].", vars(entry), lengths)
    vertices = values.get("surface_vertices")
    for name, many in (("edges", lengths["K"]), ("symmetric_pairs", lengths["K"]), ("surface_faces", _rows(vertices))):
        _check_indices(name, values.get(name), many)
    for name, around in values.get("faces", {}).items():
        _check_indices(f"faces[{name}]", around, lengths["K"])


def _check(where: str, values: Mapping[str, Any], lengths: Mapping[str, int]) -> None:
    for name, symbols in _SHAPES.items():
        if values.get(name) is None:
            continue
        shape = tuple(lengths[symbol] if isinstance(symbol, str) else symbol for symbol in symbols)
        if not has_shape(values[name].shape, shape):
            field, got = where + name, f"shape {values[name].shape}"
            raise InvalidInputError(field, got, f"{_FIX}: an array of shape {shape_words(shape)}.")


def _check_indices(name: str, given: Any, many: int) -> None:
    indices = np.asarray(() if given is None else given)
    if indices.size and (indices.dtype.kind != "i" or indices.min() < 0 or indices.max() >= many):
        raise InvalidInputError(name, given, f"{_FIX}: numbers from 0 to {many - 1}.")


def _rows(array: NDArray[np.float64] | None) -> int:
    return 0 if array is None else len(array)
