"""What the image and the 3D scene of a recording show: camera, photograph, vehicle at every step, truth, result."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.camera import Ground
from fgrecon.core.vehicle_mesh import VehicleMesh
from fgrecon.viz import entities, style
from fgrecon.viz.columns import Column, column, fixed_columns, strip_column
from fgrecon.viz.geometry import (
    BOX_EDGES,
    ellipsoids,
    ground_grid,
    image_points,
    outline_corners,
    resolution,
    vertex_normals,
)
from fgrecon.viz.photograph import Photograph
from fgrecon.viz.planes import face_outlines, fan, medial_outlines
from fgrecon.viz.playback import Playback, Rows
from fgrecon.viz.truth import Truth

__all__ = [
    "line_style",
    "log_camera",
    "log_frame",
    "log_ground",
    "log_image",
    "log_model",
    "log_result",
    "log_steps",
    "log_truth",
]

_AXES = (3, 2, 5)  # right, down, forward in rerun's numbers
_SURFACE_ALPHA = 150  # of 255: the wireframe shows through
_PLANE_ALPHA = 40
_FAINT = 90
_IMAGE_PLANE = 0.15  # distance of the drawn image plane from the camera, relative to the vehicle's distance
_FARTHEST_PLANE = 1.5  # metres
_LINE = 1.25  # half width of the lines that matter; negative radii are in points of the screen


def line_style(dimension: int, colour: tuple[int, ...], radius: float, order: float = 0.0) -> dict[str, Any]:
    """How line strips look in 2D or 3D: an archetype and its fields, as `fixed` takes them."""
    import rerun as rr

    if dimension == 2:
        return {"archetype": rr.LineStrips2D, "colors": colour, "radii": -radius, "draw_order": order}
    return {"archetype": rr.LineStrips3D, "colors": colour, "radii": -radius}


def log_camera(play: Playback, photograph: Photograph | None) -> None:
    """The camera and its frame."""
    import rerun as rr

    depth = play.reconstruction.location[2]
    distance = min(_IMAGE_PLANE * depth, _FARTHEST_PLANE) if np.isfinite(depth) and depth > 0 else _FARTHEST_PLANE
    play.once(entities.SCENE, rr.ViewCoordinates, xyz=_AXES)
    values = {
        "image_from_camera": play.camera.matrix[None],
        "resolution": np.array([resolution(play.camera, None if photograph is None else photograph.pixels)]),
        "image_plane_distance": np.array([distance]),
    }
    look = fixed_columns(rr.Pinhole, color=style.SCREEN_INK)
    play.always(entities.CAMERA, [*look, *(column(rr.Pinhole, name, value) for name, value in values.items())])


def log_image(play: Playback, photograph: Photograph | None) -> None:
    """The photograph."""
    import rerun as rr

    if photograph is not None:
        play.once(entities.IMAGE, rr.EncodedImage, media_type="image/jpeg", draw_order=-10.0)
        play.at_start(entities.IMAGE, photograph.columns)


def log_frame(play: Playback, photograph: Photograph | None) -> None:
    """The photograph and the 2D box of the observation."""
    import rerun as rr

    log_image(play, photograph)
    box = play.observation.box
    if box is not None:
        play.once(entities.BOX_2D, rr.Boxes2D, colors=style.SCREEN_INK, radii=-0.5)
        values = {"centers": (box[None, :2] + box[None, 2:]) / 2, "half_sizes": (box[None, 2:] - box[None, :2]) / 2}
        play.at_start(entities.BOX_2D, [column(rr.Boxes2D, name, value) for name, value in values.items()])


def log_truth(play: Playback, truth: Truth) -> None:
    """The true box and keypoints, in 3D and in the image."""
    import rerun as rr

    pose = truth.camera_T_object
    play.at_start(entities.TRUTH_3D, _pose_columns(pose[None]))
    if truth.box_size is not None:
        corners = outline_corners(truth.box_size)
        pixels = image_points(play.camera, pose, corners)
        play.once(f"{entities.TRUTH_3D}/box", **line_style(3, style.TRUTH, _LINE))
        play.at_start(f"{entities.TRUTH_3D}/box", [strip_column(rr.LineStrips3D, corners[None, BOX_EDGES])])
        play.once(entities.TRUTH_2D, **line_style(2, style.TRUTH, 0.75, 5.0))
        play.at_start(entities.TRUTH_2D, [strip_column(rr.LineStrips2D, pixels[None, BOX_EDGES])])
    if truth.keypoints is not None:
        known = np.isfinite(truth.keypoints).all(axis=1)
        play.once(f"{entities.TRUTH_3D}/keypoints", rr.Points3D, colors=style.TRUTH, radii=-3.0)
        points = [column(rr.Points3D, "positions", truth.keypoints[known])]
        play.at_start(f"{entities.TRUTH_3D}/keypoints", points)


def log_steps(rows: Rows) -> None:
    """What image and scene show at every step."""
    _log_image_steps(rows)
    _log_scene_steps(rows)
    _log_planes(rows)


def _log_image_steps(rows: Rows) -> None:
    """Keypoints by weight, projected wireframe now and before, residuals."""
    import rerun as rr

    measured: NDArray[np.bool_] = np.isfinite(rows.detected[..., 0])
    if measured.any():
        names = np.array(rows.look.keypoint_names)[np.nonzero(measured)[1]].tolist()
        counts = measured.sum(axis=1)
        values: dict[str, Any] = {
            "positions": rows.detected[measured],
            "colors": rows.colours[measured],
            "radii": -style.weight_radii(rows.weights)[measured],
            "labels": names,
        }
        rows.once(entities.KEYPOINTS_2D, rr.Points2D, show_labels=False, draw_order=30.0)
        rows.send(entities.KEYPOINTS_2D, [column(rr.Points2D, name, v, counts) for name, v in values.items()])
        rows.once(entities.RESIDUALS, **line_style(2, style.SCREEN_INK, 0.75, 20.0))
        rows.strips(entities.RESIDUALS, rr.LineStrips2D, np.stack([rows.detected, rows.pixels], axis=2))
    for side, edges in rows.edges.items():
        entity = f"{entities.WIREFRAME_2D}/{side.value}"
        rows.once(entity, **line_style(2, style.SIDE_COLOURS[side], _LINE, 10.0))
        rows.strips(entity, rr.LineStrips2D, rows.pixels[:, edges])
    rows.once(entities.PREVIOUS_2D, **line_style(2, (*style.PREVIOUS, _FAINT), 0.6, 8.0))
    rows.strips(entities.PREVIOUS_2D, rr.LineStrips2D, rows.pixels[rows.previous][:, rows.look.edges])


def _log_scene_steps(rows: Rows) -> None:
    """Pose, keypoints by weight, wireframe now and before."""
    import rerun as rr

    rows.send(entities.VEHICLE, _pose_columns(rows.poses))
    names = rows.look.keypoint_names
    rows.once(entities.KEYPOINTS_3D, rr.Points3D, labels=names, show_labels=False, radii=-4.0)
    count = rows.keypoints.shape[1]
    positions = column(rr.Points3D, "positions", rows.keypoints.reshape(-1, 3), count)
    rows.send(entities.KEYPOINTS_3D, [positions, column(rr.Points3D, "colors", rows.colours.reshape(-1, 3), count)])
    for side, edges in rows.edges.items():
        entity = f"{entities.WIREFRAME_3D}/{side.value}"
        rows.once(entity, **line_style(3, style.SIDE_COLOURS[side], _LINE))
        rows.strips(entity, rr.LineStrips3D, rows.keypoints[:, edges])
    rows.once(entities.PREVIOUS_3D, **line_style(3, (*style.PREVIOUS, _FAINT), 0.6))
    before = rows.keypoints_in_camera[rows.previous]
    rows.strips(entities.PREVIOUS_3D, rr.LineStrips3D, before[:, rows.look.edges])


def _pose_columns(poses: NDArray[np.float64]) -> list[Column]:
    """Columns of poses (n, 4, 4), one a row."""
    import rerun as rr

    return [
        column(rr.Transform3D, "translation", poses[:, :3, 3], 1),
        column(rr.Transform3D, "mat3x3", poses[:, :3, :3], 1),
    ]


def _log_planes(rows: Rows) -> None:
    """The planes of the faces, and the medial plane."""
    import rerun as rr

    outlines = face_outlines(rows.keypoints, rows.look.faces)
    if len(rows.look.symmetric_pairs):
        outlines[entities.MEDIAL] = medial_outlines(rows.keypoints, rows.look.symmetric_pairs)
    for index, (name, outline) in enumerate(outlines.items()):
        corners = outline.shape[1]
        entity = f"{entities.PLANES}/{name}"
        colour = (*style.plane_colour(index), _PLANE_ALPHA)
        rows.once(entity, rr.Mesh3D, triangle_indices=fan(corners), albedo_factor=colour)
        rows.send(entity, [column(rr.Mesh3D, "vertex_positions", outline.reshape(-1, 3), corners)])


def log_ground(play: Playback, ground: Ground | None) -> None:
    """A grid on the ground around the result."""
    import rerun as rr

    grid = ground_grid(play.reconstruction.camera_T_object, ground)
    look = fixed_columns(**line_style(3, style.GROUND, 0.4))
    play.always(entities.GROUND, [*look, strip_column(rr.LineStrips3D, grid[None])])


def log_result(play: Playback) -> None:
    """What only the result has: surface, box, uncertainty of the keypoints."""
    import rerun as rr

    result = play.reconstruction
    play.once(entities.VEHICLE_BOX, **line_style(3, style.SCREEN_INK, 0.75))
    corners = outline_corners(result.box_size)[None, BOX_EDGES]
    play.at_result(entities.VEHICLE_BOX, [strip_column(rr.LineStrips3D, corners)])
    if result.surface_vertices is not None and result.surface_faces is not None:
        colour = (*style.SURFACE, _SURFACE_ALPHA)
        _log_mesh(play, entities.SURFACE, result.surface_vertices, result.surface_faces, colour)
    if result.keypoint_covariance is not None:
        axes, rotations = ellipsoids(result.keypoint_covariance)
        look = {"colors": style.UNCERTAINTY, "fill_mode": "MajorWireframe", "line_radii": -0.5}
        play.once(entities.UNCERTAINTY, rr.Ellipsoids3D, **look)
        shapes = [
            column(rr.Ellipsoids3D, "half_sizes", axes),
            column(rr.InstancePoses3D, "translations", result.wireframe),
            column(rr.InstancePoses3D, "mat3x3", rotations),
        ]
        play.at_result(entities.UNCERTAINTY, shapes)


def log_model(play: Playback, model: VehicleMesh) -> None:
    """The closest car model, where the vehicle is."""
    _log_mesh(play, entities.MODEL, model.vertices, model.faces, style.MODEL)


def _log_mesh(
    play: Playback, entity: str, vertices: NDArray[np.float64], faces: NDArray[np.int64], colour: tuple[int, ...]
) -> None:
    import rerun as rr

    play.once(entity, rr.Mesh3D, albedo_factor=colour)
    values = {
        "vertex_positions": vertices,
        "triangle_indices": faces,
        "vertex_normals": vertex_normals(vertices, faces),
    }
    play.at_result(entity, [column(rr.Mesh3D, name, value) for name, value in values.items()])
