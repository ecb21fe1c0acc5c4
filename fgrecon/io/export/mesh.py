"""Surfaces and wireframes as meshes: PLY for anything that reads triangles, GLB with a node for each part.

Wireframes are thin tubes with a ball at each keypoint, since few programs draw bare lines; the vehicle's left is blue
and its right vermilion, as everywhere. PLY has the camera's frame (x right, y down, z forward, metres); GLB, whose
y axis points up by definition, is turned by half a turn about x.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.errors import InvalidInputError
from fgrecon.core.text import distinct
from fgrecon.core.vehicle_mesh import SIDE_COLOURS, SURFACE, Colour, VehicleMesh, edge_sides, keypoint_sides
from fgrecon.io.export.results import NamedResult

_TUBE, _BALL = 0.012, 0.03  # radii, metres
_SIDES = 8
_UPRIGHT = np.diag([1.0, -1.0, -1.0, 1.0])


def ply_bytes(results: Sequence[NamedResult]) -> bytes:
    """One binary PLY of all vehicles in the camera frame, with a colour at each vertex.

    Raises:
        InvalidInputError: No vehicle has a pose.
    """
    import trimesh

    meshes = [mesh for item in _solved(results) for _, mesh in _parts(item)]
    return trimesh.util.concatenate(meshes).export(file_type="ply")


def glb_bytes(results: Sequence[NamedResult], models: Mapping[str, VehicleMesh] | None = None) -> bytes:
    """One GLB with the nodes `<id>/surface` and `<id>/wireframe` of every vehicle; ids that several have are numbered.

    Args:
        models: A mesh that stands in for a vehicle, by its name: the node `<id>/model`; or None.

    Raises:
        InvalidInputError: No vehicle has a pose.
    """
    import trimesh

    scene = trimesh.Scene()
    taken = set[str]()  # of nodes with one name only the last would be kept
    for item in _solved(results):
        vehicle = distinct(item.name, taken)
        for part, mesh in _parts(item, (models or {}).get(item.name)):
            name = f"{vehicle}/{part}"
            scene.add_geometry(mesh, node_name=name, geom_name=name, transform=_UPRIGHT)
    return trimesh.exchange.gltf.export_glb(scene, tree_postprocessor=_paint)


def _paint(tree: dict[str, Any]) -> None:
    """Say that the parts are no metal, which they are by default: that is black where nothing is around to mirror."""
    tree["materials"] = [{"pbrMetallicRoughness": {"metallicFactor": 0.0, "roughnessFactor": 0.8}}]
    for mesh in tree["meshes"]:
        for primitive in mesh["primitives"]:
            primitive["material"] = 0


def _solved(results: Sequence[NamedResult]) -> list[NamedResult]:
    found = [item for item in results if item.solved]
    if not found:
        raise InvalidInputError("results", "no vehicle with a pose", "Give at least one that was reconstructed.")
    return found


def _parts(item: NamedResult, model: VehicleMesh | None = None) -> Iterator[tuple[str, Any]]:
    """The surface, where the prior has one, and the wireframe, in the camera frame; or the model in their place."""
    import trimesh

    if model is not None:
        yield "model", _finish(trimesh.Trimesh(model.vertices, model.faces), SURFACE, item.result.camera_T_object)
        return
    result = item.result
    if result.shape.surface_vertices is not None and result.shape.surface_faces is not None:
        surface = trimesh.Trimesh(result.shape.surface_vertices, result.shape.surface_faces, process=False)
        yield "surface", _finish(surface, SURFACE, result.camera_T_object)
    sides = keypoint_sides(result.shape.keypoint_names, result.wireframe)
    pieces = []
    for side, edges in edge_sides(result.shape.edges, sides).items():
        for start, end in result.wireframe[edges]:
            if np.linalg.norm(end - start) > 0:
                tube = trimesh.creation.cylinder(_TUBE, segment=[start, end], sections=_SIDES)
                pieces.append(_finish(tube, SIDE_COLOURS[side], result.camera_T_object))
    for point, side in zip(result.wireframe, sides, strict=True):
        ball = trimesh.creation.icosphere(subdivisions=1, radius=_BALL).apply_translation(point)
        pieces.append(_finish(ball, SIDE_COLOURS[side], result.camera_T_object))
    yield "wireframe", trimesh.util.concatenate(pieces)


def _finish(mesh: Any, colour: Colour, camera_T_object: NDArray[np.float64]) -> Any:
    """Colour a mesh and bring it into the camera frame."""
    mesh.visual.vertex_colors = (*colour, 255)
    return mesh.apply_transform(camera_T_object)
