"""Car models of a folder: meshes (OBJ, PLY, GLB), and npz files that hold many.

A mesh is in metres. Which of its axes points forward and which up is given; its origin does not matter, since it is
moved to the ground below the centre of its box. `NAME.json` beside `NAME.obj` may tell the keypoints, in the mesh's
own axes: `{"keypoints": {"left_front_wheel": [x, y, z], ...}}`.

An npz file has the object frame: `car_names` (M,), `vertices` (M, V, 3), `faces` (F, 3), and may have `keypoints`
(M, K, 3), in the order of the category or of `keypoint_names` (K,).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.category import Category
from fgrecon.core.checks import as_finite, as_shape
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.text import whole_text
from fgrecon.core.vehicle_mesh import VehicleMesh
from fgrecon.io.arrays import read_arrays
from fgrecon.io.json_fields import Fields, read_json

ENDINGS = (".obj", ".ply", ".glb", ".npz")
"""Endings of the files that are read."""

_ARRAYS = ("car_names", "vertices", "faces", "keypoints", "keypoint_names")
_AXES: Mapping[str, str] = {".obj": "x,-y", ".ply": "x,-y", ".glb": "z,y"}
"""Forward and up: of the object frame, and of glTF, which says so."""
_SIZES = (0.5, 40.0)  # metres: the longest side of a vehicle's box
_METRES = "Scale it to metres."


def read_models(folder: Path, category: Category, axes: str | None = None) -> list[VehicleMesh]:
    """The models of all files in a folder, or of one file, in the order of their names.

    Args:
        axes: What points forward and up in meshes, such as `x,z`; None for x and -y, and in GLB files z and y.
    """
    if axes is not None:
        check_axes(axes)
    if not folder.exists():
        raise InvalidInputError("models", str(folder), "Give a folder with meshes, or a file.")
    files = [folder] if folder.is_file() else sorted(p for p in folder.iterdir() if p.suffix.lower() in ENDINGS)
    models = [model for file in files for model in _read(file, category, axes)]
    if not models:
        raise InvalidInputError("models", str(folder), f"Give a folder with {', '.join(ENDINGS)}.")
    return models


def check_axes(axes: str) -> NDArray[np.float64]:
    """(3, 3) rotation into the object frame (x forward, y down, z left) of axes such as `x,z`: forward and up.

    Raises:
        InvalidInputError: These are not two axes at right angles.
    """
    found = []
    for name in axes.split(","):
        sign, letter = (-1.0, name.strip()[1:]) if name.strip().startswith("-") else (1.0, name.strip())
        if letter not in ("x", "y", "z"):
            raise InvalidInputError("models_axes", axes, "Give what points forward and up, such as x,z or z,y.")
        found.append(sign * np.eye(3)["xyz".index(letter)])
    if len(found) != 2 or abs(found[0] @ found[1]) > 0:
        raise InvalidInputError("models_axes", axes, "Give two different axes, such as x,z.")
    forward, up = found
    return np.stack([forward, -up, np.cross(up, forward)])


def _read(file: Path, category: Category, axes: str | None) -> Iterator[VehicleMesh]:
    ending = file.suffix.lower()
    if ending == ".npz":
        yield from _archive(file, category)
    elif ending in ENDINGS:
        yield _mesh(file, category, check_axes(axes or _AXES[ending]))
    else:
        raise InvalidInputError("models", str(file), f"Give a file that ends in {', '.join(ENDINGS)}.")


def _mesh(file: Path, category: Category, turn: NDArray[np.float64]) -> VehicleMesh:
    """A mesh, turned and moved into the object frame, with the keypoints that are given beside it."""
    import trimesh

    fix = "Give a mesh of triangles, as a modelling program exports it."
    try:
        with file.open("rb") as content:
            loaded: Any = trimesh.load_mesh(content, file_type=file.suffix.lower()[1:], skip_materials=True)
        vertices = as_shape("vertices", loaded.vertices, (None, 3))
        faces = as_shape("faces", loaded.faces, (None, 3)).astype(np.int64)
    except OSError as error:
        raise InvalidInputError("models", str(file), f"Give a file that can be read ({error.strerror}).") from error
    except Exception as error:  # trimesh promises no kind of error for damaged content
        raise InvalidInputError("models", str(file), f"{fix} The reason: {error}") from error
    vertices = _checked(vertices, faces, str(file), fix) @ turn.T
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    origin = np.array([(low[0] + high[0]) / 2, high[1], (low[2] + high[2]) / 2])
    beside = file.with_suffix(".json")
    marked = _keypoints(beside, category) if beside.is_file() else {}
    keypoints = {name: turn @ point - origin for name, point in marked.items()}
    return VehicleMesh(whole_text(file.stem), vertices - origin, faces, keypoints)


def _keypoints(file: Path, category: Category) -> dict[str, NDArray[np.float64]]:
    fields = Fields(Fields(read_json(file), f"{file}: ").get("keypoints", dict), f"{file}: keypoints: ")
    unknown = sorted(set(fields.data) - set(category.keypoints))
    if unknown:
        raise InvalidInputError(fields.where.rstrip(": "), unknown[0], f"Use the names of {category.name}.")
    return {name: fields.numbers(name, (3,)) for name in fields.data}


def _archive(file: Path, category: Category) -> Iterator[VehicleMesh]:
    fix = "Give arrays car_names (M,), vertices (M, V, 3) and faces (F, 3), in metres in the object frame."
    try:
        arrays = read_arrays(file, str(file), fix, _ARRAYS)
    except OSError as error:
        raise InvalidInputError("models", str(file), f"Give a file that can be read ({error.strerror}).") from error
    if not {*_ARRAYS[:3]} <= set(arrays):
        raise InvalidInputError(str(file), ", ".join(sorted(arrays)) or "no arrays", fix)
    named = np.atleast_1d(arrays["car_names"])
    vertices = as_finite(f"{file}: vertices", arrays["vertices"], (len(named), None, 3), fix)
    faces = as_finite(f"{file}: faces", arrays["faces"], (None, 3), fix).astype(np.int64)
    points, names = None, [str(name) for name in arrays.get("keypoint_names", np.array(category.keypoints))]
    if "keypoints" in arrays:
        given = f"Give (M, {len(names)}, 3), or keypoint_names as well."
        points = as_finite(f"{file}: keypoints", arrays["keypoints"], (len(named), len(names), 3), given)
    for index, name in enumerate(named.tolist()):
        own = _checked(vertices[index], faces, f"{file}: {name}", fix)
        keypoints = {} if points is None else dict(zip(names, points[index], strict=True))
        yield VehicleMesh(str(name), own, faces, keypoints)


def _checked(vertices: NDArray[np.float64], faces: NDArray[np.int64], where: str, fix: str) -> NDArray[np.float64]:
    """The vertices of a mesh that is as large as a vehicle."""
    if not len(vertices) or not len(faces) or faces.min() < 0 or faces.max() >= len(vertices):
        raise InvalidInputError(f"models: {where}", f"{len(vertices)} vertices, {len(faces)} triangles", fix)
    if not np.isfinite(vertices).all():
        raise InvalidInputError(f"models: {where}", "a vertex that is not finite", fix)
    longest = float(np.ptp(vertices[np.unique(faces)], axis=0).max())
    if not _SIZES[0] <= longest <= _SIZES[1]:
        raise InvalidInputError(f"models: {where}", f"{longest:.4g} long", _METRES)
    return vertices
