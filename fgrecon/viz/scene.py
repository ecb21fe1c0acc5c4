"""What the image and the 3D scene of a recording show: camera, photograph, vehicle at every step, truth, result."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgrecon.camera import Ground
from fgrecon.viz import entities, style
from fgrecon.viz.geometry import (
    BOX_EDGES,
    box_corners,
    ellipsoids,
    ground_grid,
    image_points,
    resolution,
    vertex_normals,
)
from fgrecon.viz.planes import face_outlines, fan, medial_outlines
from fgrecon.viz.playback import Playback, Rows
from fgrecon.viz.style import Colour
from fgrecon.viz.truth import Truth

__all__ = ["line_style", "log_camera", "log_frame", "log_ground", "log_result", "log_steps", "log_truth"]

_JPEG_QUALITY = 92
_SURFACE_ALPHA = 150  # of 255: the wireframe shows through
_PLANE_ALPHA = 40
_FAINT = 90
_IMAGE_PLANE = 0.15  # distance of the drawn image plane from the camera, relative to the vehicle's distance
_FARTHEST_PLANE = 1.5  # metres
_LINE = 1.25  # half width of the lines that matter; negative radii are in points of the screen


@lru_cache(maxsize=64)
def line_style(dimension: int, colour: tuple[int, ...], radius: float, order: float = 0.0) -> Any:
    """Component batches that style line strips in 2D or 3D, made once: they are the same in every recording."""
    import rerun as rr

    if dimension == 2:
        return rr.LineStrips2D.from_fields(colors=colour, radii=-radius, draw_order=order).as_component_batches()
    return rr.LineStrips3D.from_fields(colors=colour, radii=-radius).as_component_batches()


@lru_cache(maxsize=4)
def _hidden_labels(order: float) -> Any:
    """The same of labelled points in the image."""
    import rerun as rr

    return rr.Points2D.from_fields(show_labels=False, draw_order=order).as_component_batches()


@lru_cache(maxsize=16)
def _point_style(names: tuple[str, ...]) -> Any:
    """The same of labelled points in 3D."""
    import rerun as rr

    return rr.Points3D.from_fields(labels=names, show_labels=False, radii=-4.0).as_component_batches()


@lru_cache(maxsize=16)
def _plane_style(corners: int, colour: Colour) -> Any:
    import rerun as rr

    mesh = rr.Mesh3D.from_fields(triangle_indices=fan(corners), albedo_factor=(*colour, _PLANE_ALPHA))
    return mesh.as_component_batches()


def log_camera(play: Playback, image: NDArray[np.uint8] | None) -> None:
    """The camera and its frame."""
    import rerun as rr

    depth = play.reconstruction.location[2]
    distance = min(_IMAGE_PLANE * depth, _FARTHEST_PLANE) if np.isfinite(depth) and depth > 0 else _FARTHEST_PLANE
    play.once(entities.SCENE, rr.ViewCoordinates.RDF)
    play.once(
        entities.CAMERA,
        rr.Pinhole(
            image_from_camera=play.camera.matrix,
            resolution=resolution(play.camera, image),
            image_plane_distance=distance,
            color=style.SCREEN_INK,
        ),
    )


def log_frame(play: Playback, image: NDArray[np.uint8] | None) -> None:
    """The photograph and the 2D box of the observation."""
    import rerun as rr

    if image is not None:
        photograph = rr.EncodedImage(contents=_jpeg(image), media_type="image/jpeg", draw_order=-10.0)
        play.at_start(entities.IMAGE, photograph)
    box = play.observation.box
    if box is not None:
        boxes = rr.Boxes2D(array=box, array_format=rr.Box2DFormat.XYXY, colors=style.SCREEN_INK, radii=-0.5)
        play.at_start(entities.BOX_2D, boxes)


def _jpeg(image: NDArray[np.uint8]) -> bytes:
    import cv2

    bgr = np.ascontiguousarray(image[..., ::-1])
    return bytes(cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])[1])


def log_truth(play: Playback, truth: Truth) -> None:
    """The true box and keypoints, in 3D and in the image."""
    import rerun as rr

    pose = truth.camera_T_object
    play.at_start(entities.TRUTH_3D, rr.Transform3D(translation=pose[:3, 3], mat3x3=pose[:3, :3]))
    if truth.box_size is not None:
        corners = box_corners(truth.box_size)
        pixels = image_points(play.camera, pose, corners)[BOX_EDGES]
        seen = np.isfinite(pixels).all(axis=(1, 2))
        box = rr.LineStrips3D(corners[BOX_EDGES], colors=style.TRUTH, radii=-_LINE)
        play.at_start(f"{entities.TRUTH_3D}/box", box)
        outline = rr.LineStrips2D(pixels[seen], colors=style.TRUTH, radii=-0.75, draw_order=5.0)
        play.at_start(entities.TRUTH_2D, outline)
    if truth.keypoints is not None:
        known = np.isfinite(truth.keypoints).all(axis=1)
        points = rr.Points3D(truth.keypoints[known], colors=style.TRUTH, radii=-3.0)
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
        counts = measured.sum(axis=1)
        names = np.array(rows.look.keypoint_names)[np.nonzero(measured)[1]]
        columns = rr.Points2D.columns(
            positions=rows.detected[measured],
            colors=style.weight_colours(rows.weights)[measured],
            radii=-style.weight_radii(rows.weights)[measured],
            labels=names.tolist(),
        )
        rows.once(entities.KEYPOINTS_2D, _hidden_labels(30.0))
        rows.send(entities.KEYPOINTS_2D, columns.partition(counts))
        rows.once(entities.RESIDUALS, line_style(2, style.SCREEN_INK, 0.75, 20.0))
        rows.strips(entities.RESIDUALS, rr.LineStrips2D, np.stack([rows.detected, rows.pixels], axis=2))
    for side, edges in rows.edges.items():
        entity = f"{entities.WIREFRAME_2D}/{side.value}"
        rows.once(entity, line_style(2, style.SIDE_COLOURS[side], _LINE, 10.0))
        rows.strips(entity, rr.LineStrips2D, rows.pixels[:, edges])
    rows.once(entities.PREVIOUS_2D, line_style(2, (*style.PREVIOUS, _FAINT), 0.6, 8.0))
    rows.strips(entities.PREVIOUS_2D, rr.LineStrips2D, rows.pixels[rows.previous][:, rows.look.edges])


def _log_scene_steps(rows: Rows) -> None:
    """Pose, keypoints by weight, wireframe now and before."""
    import rerun as rr

    transforms = rr.Transform3D.columns(translation=rows.poses[:, :3, 3], mat3x3=rows.poses[:, :3, :3])
    rows.send(entities.VEHICLE, transforms)
    rows.once(entities.KEYPOINTS_3D, _point_style(rows.look.keypoint_names))
    columns = rr.Points3D.columns(
        positions=rows.keypoints.reshape(-1, 3), colors=style.weight_colours(rows.weights).reshape(-1, 3)
    )
    rows.send(entities.KEYPOINTS_3D, columns.partition([rows.keypoints.shape[1]] * len(rows.steps)))
    for side, edges in rows.edges.items():
        entity = f"{entities.WIREFRAME_3D}/{side.value}"
        rows.once(entity, line_style(3, style.SIDE_COLOURS[side], _LINE))
        rows.strips(entity, rr.LineStrips3D, rows.keypoints[:, edges])
    rows.once(entities.PREVIOUS_3D, line_style(3, (*style.PREVIOUS, _FAINT), 0.6))
    before = rows.keypoints_in_camera[rows.previous]
    rows.strips(entities.PREVIOUS_3D, rr.LineStrips3D, before[:, rows.look.edges])


def _log_planes(rows: Rows) -> None:
    """The planes of the faces, and the medial plane."""
    import rerun as rr

    outlines = {name: face_outlines(rows.keypoints, face) for name, face in rows.look.faces.items()}
    if len(rows.look.symmetric_pairs):
        outlines[entities.MEDIAL] = medial_outlines(rows.keypoints, rows.look.symmetric_pairs)
    for index, (name, outline) in enumerate(outlines.items()):
        count, corners = outline.shape[:2]
        entity = f"{entities.PLANES}/{name}"
        rows.once(entity, _plane_style(corners, style.plane_colour(index)))
        rows.send(entity, rr.Mesh3D.columns(vertex_positions=outline.reshape(-1, 3)).partition([corners] * count))


def log_ground(play: Playback, ground: Ground | None) -> None:
    """A grid on the ground around the result."""
    import rerun as rr

    grid = ground_grid(play.reconstruction.camera_T_object, ground)
    play.once(entities.GROUND, rr.LineStrips3D(grid, colors=style.GROUND, radii=-0.4))


def log_result(play: Playback) -> None:
    """What only the result has: surface, box, uncertainty of the keypoints."""
    import rerun as rr

    result = play.reconstruction
    corners = box_corners(result.box_size)[BOX_EDGES]
    play.at_result(entities.VEHICLE_BOX, rr.LineStrips3D(corners, colors=style.SCREEN_INK, radii=-0.75))
    if result.surface_vertices is not None and result.surface_faces is not None:
        surface = rr.Mesh3D(
            vertex_positions=result.surface_vertices,
            triangle_indices=result.surface_faces,
            vertex_normals=vertex_normals(result.surface_vertices, result.surface_faces),
            albedo_factor=(*style.SURFACE, _SURFACE_ALPHA),
        )
        play.at_result(entities.SURFACE, surface)
    if result.keypoint_covariance is not None:
        axes, rotations = ellipsoids(result.keypoint_covariance)
        play.at_result(
            entities.UNCERTAINTY,
            rr.Ellipsoids3D(half_sizes=axes, colors=style.UNCERTAINTY, fill_mode="MajorWireframe", line_radii=-0.5),
            rr.InstancePoses3D(translations=result.wireframe, mat3x3=rotations),
        )
