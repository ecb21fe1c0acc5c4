"""Car models as meshes: the nearest one to a vehicle, and the colours of its sides."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.errors import InvalidInputError
from fgrecon.core.metrics import hausdorff_distance
from fgrecon.core.reconstruction import Reconstruction
from fgrecon.core.repr import brief_repr

_SPACING = 0.1  # metres between the points that stand for a surface, at most
_FINEST = 64  # parts of a triangle's side, at most: a plane under a car may come with it


@dataclass(frozen=True, eq=False)
class VehicleMesh:
    """A vehicle's mesh, object frame: x forward, y down, z left, origin on the ground below the centre, metres.

    Attributes:
        name: What it is called.
        vertices: (V, 3) vertices.
        faces: (F, 3) vertex indices of each triangle.
        keypoints: (3,) place of each keypoint that is known on it, by name; may be empty.
    """

    name: str
    vertices: NDArray[np.float64]
    faces: NDArray[np.int64]
    keypoints: Mapping[str, NDArray[np.float64]] = field(default_factory=dict)

    __repr__ = brief_repr

    @cached_property
    def surface_points(self) -> NDArray[np.float64]:
        """(S, 3) points all over the triangles, 0.1 m apart at most."""
        return _points_on(self.vertices, self.faces)


@dataclass(frozen=True, eq=False)
class ModelDistances:
    """How far M models are from a vehicle, both in the object frame."""

    hausdorff: NDArray[np.float64]  # (M,) symmetric Hausdorff distance, metres: of the wireframes, or of the surfaces
    # (M,) mean distance of the keypoints, metres; NaN where the models have none in common
    keypoints: NDArray[np.float64]
    between: str  # what the Hausdorff distance is between: `keypoints` or `surfaces`


@dataclass(frozen=True, eq=False)
class ClosestModel:
    """The model that a vehicle comes nearest to."""

    model: VehicleMesh
    hausdorff: float  # its Hausdorff distance, metres
    keypoints: float  # mean distance of its keypoints, metres; NaN where there are none
    second: str  # name of the next one; empty where there is no other
    margin: float  # by how much the next one's Hausdorff distance is larger, metres; infinite where there is no other
    between: str  # what the Hausdorff distance is between: `keypoints` or `surfaces`
    count: int  # how many models there were to choose from

    __repr__ = brief_repr

    def to_dict(self) -> dict[str, Any]:
        """Name and distances for JSON; what is not known is None. Lengths in metres, to a tenth of a millimetre."""
        return {
            "name": self.model.name,
            "hausdorff": round(self.hausdorff, 4),
            "between": self.between,
            "keypoints": round(self.keypoints, 4) if np.isfinite(self.keypoints) else None,
            "second": self.second or None,
            "margin": round(self.margin, 4) if np.isfinite(self.margin) else None,
            "models": self.count,
        }

    def __str__(self) -> str:
        """In words, with the margin."""
        closest = f"{self.model.name}, {100 * self.hausdorff:.0f} cm away (Hausdorff distance of the {self.between})"
        return f"{closest}; {self.second} is {100 * self.margin:.0f} cm farther" if self.second else closest


def model_distances(
    names: Sequence[str],
    wireframe: NDArray[np.float64],
    surface: NDArray[np.float64] | None,
    models: Sequence[VehicleMesh],
) -> ModelDistances:
    """How far each model is from a shape.

    The wireframes of keypoints are compared where every model has them, which needs no more than the result; else the
    surfaces.

    Args:
        names: K names of keypoints.
        wireframe: (K, 3) the shape's keypoints, object frame, metres.
        surface: (S, 3) points of its surface, or None.

    Raises:
        InvalidInputError: There is no model, or neither keypoints nor surfaces can be compared.
    """
    if not models:
        raise InvalidInputError("models", "none", "Give at least one.")
    common = [i for i, name in enumerate(names) if all(name in model.keypoints for model in models)]
    nan = np.full(len(models), np.nan)
    if common:
        shape = wireframe[common]
        known = np.array([[model.keypoints[names[i]] for i in common] for model in models])
        hausdorff = np.array([hausdorff_distance(shape, points) for points in known])
        return ModelDistances(hausdorff, np.linalg.norm(known - shape, axis=2).mean(axis=1), "keypoints")
    if surface is None:
        fix = "Give models with keypoints beside them, or a prior with a surface."
        raise InvalidInputError("models", "no keypoints, and the shape prior has no surface", fix)
    hausdorff = np.array([hausdorff_distance(surface, model.surface_points) for model in models])
    return ModelDistances(hausdorff, nan, "surfaces")


def closest_model(result: Reconstruction, models: Sequence[VehicleMesh]) -> ClosestModel:
    """The model that is nearest to a result in the Hausdorff distance; see `model_distances`.

    Args:
        result: The vehicle.
        models: What to choose from.

    Raises:
        InvalidInputError: There is no model, or neither keypoints nor surfaces can be compared.
    """
    surface = None
    if result.shape.surface_vertices is not None and result.shape.surface_faces is not None:
        surface = _points_on(result.shape.surface_vertices, result.shape.surface_faces)
    found = model_distances(result.shape.keypoint_names, result.wireframe, surface, models)
    order = np.argsort(found.hausdorff, kind="stable")
    first, second = int(order[0]), int(order[1]) if len(order) > 1 else None
    return ClosestModel(
        model=models[first],
        hausdorff=float(found.hausdorff[first]),
        keypoints=float(found.keypoints[first]),
        second="" if second is None else models[second].name,
        margin=float("inf") if second is None else float(found.hausdorff[second] - found.hausdorff[first]),
        between=found.between,
        count=len(models),
    )


def _points_on(vertices: NDArray[np.float64], faces: NDArray[np.int64]) -> NDArray[np.float64]:
    """(S, 3) points of triangles: a grid on each that is as fine as its longest side asks for, corners included."""
    corners = vertices[faces]
    sides = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    parts = np.clip(np.ceil(sides / _SPACING), 1, _FINEST).astype(np.int64)
    found = [corners.reshape(-1, 3)]
    for count in np.unique(parts[parts > 1]):
        grid = np.array([(i, j, count - i - j) for i in range(count + 1) for j in range(count + 1 - i)]) / count
        found.append((grid @ corners[parts == count]).reshape(-1, 3))
    return np.unique(np.concatenate(found), axis=0)


_MEDIAL = 1e-3  # metres from the medial plane

Colour = tuple[int, int, int]


class Side(StrEnum):
    """The vehicle's own side that a keypoint or an edge lies on."""

    LEFT = "left"
    RIGHT = "right"
    ACROSS = "across"
    """On the medial plane, or an edge from one side to the other."""


SIDE_COLOURS: dict[Side, Colour] = {Side.LEFT: (0, 114, 178), Side.RIGHT: (213, 94, 0), Side.ACROSS: (140, 140, 140)}
"""Blue is the vehicle's left, vermilion its right, grey what joins them."""
SURFACE: Colour = (196, 204, 214)
"""The reconstructed surface."""


def keypoint_sides(names: tuple[str, ...], wireframe: NDArray[np.float64]) -> tuple[Side, ...]:
    """Side of each of K keypoints: from names that begin with `left` or `right`, else from z (left is positive).

    Args:
        names: K keypoint names.
        wireframe: (K, 3) keypoints in the object frame, metres.
    """

    def side(name: str, z: float) -> Side:
        for value in (Side.LEFT, Side.RIGHT):
            if name.startswith(value.value):
                return value
        if not np.isfinite(z) or abs(z) < _MEDIAL:
            return Side.ACROSS
        return Side.LEFT if z > 0 else Side.RIGHT

    return tuple(side(name, z) for name, z in zip(names, wireframe[:, 2], strict=True))


def edge_sides(edges: NDArray[np.int64], sides: tuple[Side, ...]) -> dict[Side, NDArray[np.int64]]:
    """The edges (E, 2) split by side, each (E_side, 2): both ends on one side, or across."""
    split: dict[Side, list[NDArray[np.int64]]] = {side: [] for side in Side}
    for edge in edges:
        a, b = sides[edge[0]], sides[edge[1]]
        split[a if a == b else Side.ACROSS].append(edge)
    return {side: np.array(group, dtype=np.int64).reshape(-1, 2) for side, group in split.items()}
