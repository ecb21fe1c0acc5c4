"""How a result ended, and the fields of its JSON, all in one level: the group of each, and how it is read."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

import numpy as np

from factors.checks import has_shape, shape_words
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.history import read_alternative, read_graph_factor, read_iteration
from fgrecon.core.serialise import array, indices, numbers, pairs, square, well_formed

_FIX = "Give the result as fgrecon wrote it"


class Status(StrEnum):
    """How a reconstruction ended."""

    CONVERGED = "converged"
    WEAK = "weak"
    """It converged, but little carries it, or it contradicts what was given: see `reasons`."""
    AMBIGUOUS = "ambiguous"
    """Another pose explains the keypoints nearly as well (see `alternatives`), or another focal length the image."""
    DEGENERATE = "degenerate"
    """The keypoints leave a direction undetermined, or nearly so: see `message` and the covariances."""
    FAILED = "failed"
    """The optimisation gave up, and this is the state before: see `message`."""

    @property
    def settled(self) -> bool:
        """Whether one pose was found, and a minimum there."""
        return self in (Status.CONVERGED, Status.WEAK)

    @property
    def determined(self) -> bool:
        """Whether the keypoints determine a pose, be it one of several."""
        return self.settled or self is Status.AMBIGUOUS


class Regions(StrEnum):
    """What the covariances of a result rest on."""

    ASSUMED = "assumed"
    """The keypoints bring none: errors of `KeypointOptions.sigma_relative` and `sigma_pixels` are assumed."""
    SHIPPED = "shipped"
    """Those of the keypoints, counted as the shipped networks' are (`KeypointOptions.common_factor`)."""
    FITTED = "fitted"
    """Those of the keypoints, counted as `fgrecon calibrate` found for their detector."""


@dataclass(frozen=True)
class ResultField:
    """One field of a result's JSON."""

    group: str  # attribute of `Reconstruction` that has it; empty where that is the result itself
    read: Callable[[Any], Any] = array  # from its plain value
    # of an array: K keypoints, N coefficients, P points, Q depth maps, None is any number
    shape: tuple[int | str | None, ...] = ()
    nullable: bool = False  # whether it can be null
    later: bool = False  # whether earlier files have it not
    large: bool = False  # whether the compact form leaves it out
    spare: bool = False  # whether it is left out where it is empty


def _items(read: Callable[[Any], Any]) -> Callable[[Any], Any]:
    return lambda items: tuple(map(read, items))


FIELDS: Mapping[str, ResultField] = {
    "status": ResultField("", Status),
    "message": ResultField("", str),
    "category": ResultField("shape", str),
    "prior": ResultField("shape", str),
    "keypoint_names": ResultField("shape", tuple),
    "camera_T_object": ResultField("pose", shape=(4, 4)),
    "coefficients": ResultField("shape", shape=("N",)),
    "offsets": ResultField("shape", shape=("K", 3)),
    "wireframe": ResultField("shape", shape=("K", 3)),
    "wireframe_uv": ResultField("pose", shape=("K", 2)),
    "edges": ResultField("shape", pairs),
    "box_size": ResultField("shape", shape=(3,)),
    "weights": ResultField("diagnostics", shape=("K",)),
    "sigmas": ResultField("diagnostics", shape=("K",)),
    "visibility": ResultField("diagnostics", shape=("K",)),
    "pose_covariance": ResultField("uncertainty", shape=(6, 6), nullable=True),
    "coefficients_covariance": ResultField("uncertainty", square, ("N", "N"), nullable=True),
    "keypoint_covariance": ResultField("uncertainty", shape=("K", 3, 3), nullable=True),
    "energies": ResultField("diagnostics", numbers),
    "alternatives": ResultField("uncertainty", _items(read_alternative)),
    "history": ResultField("diagnostics", _items(read_iteration), large=True),
    "milliseconds": ResultField("diagnostics", numbers),
    "surface_vertices": ResultField("shape", shape=(None, 3), nullable=True, large=True),
    "surface_faces": ResultField("shape", indices, (None, 3), nullable=True, large=True),
    "faces": ResultField("shape", lambda faces: {name: tuple(keypoints) for name, keypoints in faces.items()}),
    "symmetric_pairs": ResultField("shape", pairs),
    "graph": ResultField("diagnostics", _items(read_graph_factor), large=True),
    "graph_iterations": ResultField("diagnostics", int, later=True),
    "graph_gain": ResultField("diagnostics", float, later=True),
    "facing_probability": ResultField("uncertainty", float, later=True),
    "reasons": ResultField("", tuple, later=True),
    "size_covariance": ResultField("uncertainty", shape=(3, 3), nullable=True, later=True),
    "regions": ResultField("uncertainty", Regions, later=True),
    "box_excess": ResultField("diagnostics", float, later=True),
    "left_out": ResultField("diagnostics", tuple, later=True),
    "mirrored_gain": ResultField("diagnostics", float, later=True),
    "points": ResultField("diagnostics", shape=("P", 3), later=True, large=True, spare=True),
    "point_weights": ResultField("diagnostics", shape=("P",), later=True, large=True, spare=True),
    "own_shares": ResultField("diagnostics", numbers, later=True, spare=True),
    "evidence": ResultField("diagnostics", numbers, later=True, spare=True),
    "depth_scales": ResultField("diagnostics", shape=("Q", 2), later=True, spare=True),
    "depth_covariances": ResultField("diagnostics", shape=("Q", 2, 2), later=True, spare=True),
    "place_errors": ResultField("diagnostics", shape=("S", 6), later=True, spare=True),
    "place_covariances": ResultField("diagnostics", shape=("S", 6, 6), later=True, spare=True),
}
"""By name, in the order of files."""

_SHAPES: Mapping[str, tuple[int | str | None, ...]] = {
    **{name: field.shape for name, field in FIELDS.items() if field.shape},
    "keypoints": ("K", 3),
    "projections": ("K", 2),
}
"""Of the arrays of results, alternatives and steps."""


def read_fields(data: Mapping[str, Any], *, compact: bool) -> dict[str, Any]:
    """The fields of a result by name, from plain values.

    Args:
        data: By name.
        compact: Whether the large fields may be left out.

    Raises:
        InvalidInputError: A field is missing or malformed, or two do not fit.
    """
    values: dict[str, Any] = {}
    for name, field in FIELDS.items():
        if name in data:
            values[name] = _read(name, field, data[name])
        elif not (field.later or (compact and field.large)):
            raise InvalidInputError("reconstruction", f"no field {name}", "Give a whole result.")
    check_shapes(values)
    return values


def _read(name: str, field: ResultField, value: Any) -> Any:
    if value is None and field.nullable:
        return None
    with well_formed(name, f"{_FIX}."):
        if value is None:
            raise TypeError("null")
        return field.read(value)


def check_shapes(values: Mapping[str, Any]) -> None:
    """Check that the arrays of a result fit one another: as many rows as keypoints, no index beyond them.

    Raises:
        InvalidInputError: A field has another shape than the others, or an index of none of them.
    """
    names = values["keypoint_names"]
    if not all(isinstance(name, str) for name in names):
        raise InvalidInputError("keypoint_names", names, f"{_FIX}: names are texts.")
    lengths = {"K": len(names), "N": np.size(values["coefficients"]), "P": len(values.get("points", ()))}
    lengths |= {"Q": len(values.get("depth_scales", ())), "S": len(values.get("place_errors", ()))}
    _check("", values, lengths)
    for name in ("pose_covariance", "size_covariance"):
        if values.get(name) is not None and not np.isfinite(values[name]).all():
            raise InvalidInputError(name, "not finite", f"{_FIX}: finite numbers, or null.")
    for kind in ("alternatives", "history"):
        for number, entry in enumerate(values.get(kind, ())):
            _check(f"{kind}[{number}].", vars(entry), lengths)
    vertices = values.get("surface_vertices")
    many = {"edges": lengths["K"], "symmetric_pairs": lengths["K"]}
    for name, count in (many | {"surface_faces": 0 if vertices is None else len(vertices)}).items():
        _check_indices(name, values.get(name), count)
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
