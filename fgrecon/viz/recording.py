"""The recording of a vehicle for the rerun viewer, made from its history after solving.

`recording_of` can be written to a file or sent to any recording stream. The names are those of `fgrecon.viz.entities`;
`fgrecon.viz.replay` reads a file back. The recordings of scenes and tracks are made of the same parts.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from fgrecon.core.arrays import Array
from fgrecon.core.camera import Ground
from fgrecon.core.geometry import transform
from fgrecon.core.history import Alternative
from fgrecon.core.vehicle_mesh import SIDE_COLOURS, SURFACE
from fgrecon.viz import entities, style
from fgrecon.viz.blueprint import vehicle_blueprint
from fgrecon.viz.columns import Outbox, fixed_columns, strip_columns
from fgrecon.viz.factor_graph import log_graph
from fgrecon.viz.geometry import (
    BOX_EDGES,
    NOSE,
    ellipsoids,
    face_outlines,
    fan,
    ground_grid,
    image_points,
    medial_outlines,
    outline_corners,
    resolution,
    vertex_normals,
)
from fgrecon.viz.playback import Playback, Rows
from fgrecon.viz.plots import log_history, log_plots, log_words
from fgrecon.viz.sinks import Recording
from fgrecon.viz.subjects import Photograph, SolvedVehicle, Truth

_AXES = (3, 2, 5)  # right, down, forward in rerun's numbers
_SURFACE_ALPHA = 150  # of 255: the wireframe shows through
_PLANE_ALPHA = 40
_FAINT = 90
_IMAGE_PLANE = 0.15  # distance of the drawn image plane from the camera, relative to the vehicle's distance
_FARTHEST_PLANE = 1.5  # metres
_LEAST_PROBABILITY = 0.01  # of other poses that are drawn
_LINE = 1.25  # half width of the lines that matter; negative radii are in points of the screen


def recording_of(vehicle: SolvedVehicle, *, ground: Ground | None = None) -> Recording:
    """The recording of a whole optimisation, with its layout.

    Args:
        vehicle: The vehicle. Its history is played back; a truth is drawn beside the estimate and plotted as errors; a
            car model is shown instead of the surface.
        ground: The ground plane that was assumed; without one the grid is below the vehicle.

    Returns:
        What can be written or sent. Making it raises an InvalidInputError where the image is not (H, W, 3) of bytes.
    """

    def make() -> Callable[[Any], None]:
        result, photograph = vehicle.reconstruction, vehicle.photograph
        play = Playback(Outbox(f"{result.shape.category}, {result.status.value}"), vehicle)
        log_camera(play, photograph)
        log_frame(play, photograph)
        log_vehicle(play)
        if vehicle.solved:
            log_ground(play, ground)
        return play.stream.empty_into

    return Recording(make, lambda: vehicle_blueprint(vehicle))


def recordings_of(sights: Sequence[SolvedVehicle], ground: Ground | None) -> list[tuple[str, Recording]]:
    """Title and recording of vehicles, with the ground plane that was assumed."""
    images = {id(s.image): Photograph.of(s.image) for s in sights}  # several vehicles may be in one
    return [(s.title, recording_of(replace(s, image=images[id(s.image)]), ground=ground)) for s in sights]


def log_vehicle(play: Playback) -> None:
    """All about a vehicle that does not depend on where it is observed.

    That is truth, every step, result, closest car model, plots, graph and words.
    """
    vehicle = play.vehicle
    if vehicle.truth is not None:
        log_truth(play, vehicle.truth)
    rows = Rows([play]) if play.steps else None
    if rows is not None:
        log_steps(rows)
        log_plots(rows)
        log_graph(rows)
        if vehicle.reconstruction.diagnostics.history:
            log_history(rows)
    if vehicle.solved:
        log_result(play)
        if vehicle.model is not None:
            _log_mesh(play, entities.MODEL, vehicle.model.vertices, vehicle.model.faces, style.MODEL)
    log_words(play, rows)


def line_style(dimension: int, colour: tuple[int, ...], radius: float, order: float = 0.0) -> dict[str, Any]:
    """How line strips look in 2D or 3D: an archetype and its fields, as `fixed` takes them."""
    if dimension == 2:
        return {"archetype": rr.LineStrips2D, "colors": colour, "radii": -radius, "draw_order": order}
    return {"archetype": rr.LineStrips3D, "colors": colour, "radii": -radius}


def log_camera(play: Playback, photograph: Photograph | None) -> None:
    """The camera and its frame."""
    depth, camera = play.vehicle.reconstruction.location[2], play.vehicle.camera
    distance = min(_IMAGE_PLANE * depth, _FARTHEST_PLANE) if np.isfinite(depth) and depth > 0 else _FARTHEST_PLANE
    play.once(entities.SCENE, rr.ViewCoordinates, xyz=_AXES)
    shape = rr.Pinhole.columns(
        image_from_camera=camera.matrix[None],
        resolution=np.array([resolution(camera, None if photograph is None else photograph.pixels)]),
        image_plane_distance=np.array([distance]),
    )
    play.always(entities.CAMERA, [*fixed_columns(rr.Pinhole, color=style.SCREEN_INK), *shape])


def log_image(play: Playback, photograph: Photograph | None) -> None:
    """The photograph."""
    if photograph is not None:
        play.once(entities.IMAGE, rr.EncodedImage, media_type="image/jpeg", draw_order=-10.0)
        play.at_start(entities.IMAGE, photograph.columns)


def log_frame(play: Playback, photograph: Photograph | None) -> None:
    """The photograph and the 2D box of the observation."""
    log_image(play, photograph)
    box = play.vehicle.observation.box
    if box is not None:
        play.once(entities.BOX_2D, rr.Boxes2D, colors=style.SCREEN_INK, radii=-0.5)
        low, high = box[None, :2], box[None, 2:]
        play.at_start(entities.BOX_2D, rr.Boxes2D.columns(centers=(low + high) / 2, half_sizes=(high - low) / 2))


def log_truth(play: Playback, truth: Truth) -> None:
    """The true box and keypoints, in 3D and in the image."""
    pose = truth.camera_T_object
    play.at_start(entities.TRUTH_3D, rr.Transform3D.columns(translation=pose[None, :3, 3], mat3x3=pose[None, :3, :3]))
    if truth.box_size is not None:
        corners = outline_corners(truth.box_size)
        pixels = image_points(play.vehicle.camera, pose, corners)
        play.once(f"{entities.TRUTH_3D}/box", **line_style(3, style.TRUTH, _LINE))
        play.at_start(f"{entities.TRUTH_3D}/box", strip_columns(rr.LineStrips3D, corners[None, BOX_EDGES]))
        play.once(entities.TRUTH_2D, **line_style(2, style.TRUTH, 0.75, 5.0))
        play.at_start(entities.TRUTH_2D, strip_columns(rr.LineStrips2D, pixels[None, BOX_EDGES]))
    if truth.keypoints is not None:
        known = np.isfinite(truth.keypoints).all(axis=1)
        play.once(f"{entities.TRUTH_3D}/keypoints", rr.Points3D, colors=style.TRUTH, radii=-3.0)
        points = rr.Points3D.columns(positions=truth.keypoints[known]).partition([known.sum()])
        play.at_start(f"{entities.TRUTH_3D}/keypoints", points)


def log_steps(rows: Rows) -> None:
    """What image and scene show at every step."""
    _log_image_steps(rows)
    _log_scene_steps(rows)
    _log_planes(rows)


def _log_image_steps(rows: Rows) -> None:
    """Keypoints by weight, projected wireframe now and before, residuals."""
    result = rows.plays[0].vehicle.reconstruction
    measured: NDArray[np.bool_] = np.isfinite(rows.detected[..., 0])
    if measured.any():
        points = rr.Points2D.columns(
            positions=rows.detected[measured],
            colors=rows.colours[measured],
            radii=-style.weight_radii(rows.weights)[measured],
            labels=np.array(result.shape.keypoint_names)[np.nonzero(measured)[1]].tolist(),
        )
        rows.once(entities.KEYPOINTS_2D, rr.Points2D, show_labels=False, draw_order=30.0)
        rows.send(entities.KEYPOINTS_2D, points.partition(measured.sum(axis=1)))
        rows.once(entities.RESIDUALS, **line_style(2, style.SCREEN_INK, 0.75, 20.0))
        rows.strips(entities.RESIDUALS, rr.LineStrips2D, np.stack([rows.detected, rows.pixels], axis=2))
    for side, edges in rows.edges.items():
        entity = f"{entities.WIREFRAME_2D}/{side.value}"
        rows.once(entity, **line_style(2, SIDE_COLOURS[side], _LINE, 10.0))
        rows.strips(entity, rr.LineStrips2D, rows.pixels[:, edges])
    rows.once(entities.PREVIOUS_2D, **line_style(2, (*style.PREVIOUS, _FAINT), 0.6, 8.0))
    rows.strips(entities.PREVIOUS_2D, rr.LineStrips2D, rows.pixels[rows.previous][:, result.shape.edges])


def _log_scene_steps(rows: Rows) -> None:
    """Pose, keypoints by weight, wireframe now and before."""
    result = rows.plays[0].vehicle.reconstruction
    poses = rr.Transform3D.columns(translation=rows.poses[:, :3, 3], mat3x3=rows.poses[:, :3, :3])
    rows.send(entities.VEHICLE, poses)
    rows.once(entities.KEYPOINTS_3D, rr.Points3D, labels=result.shape.keypoint_names, show_labels=False, radii=-4.0)
    points = rr.Points3D.columns(positions=rows.keypoints.reshape(-1, 3), colors=rows.colours.reshape(-1, 3))
    rows.send(entities.KEYPOINTS_3D, points.partition([rows.keypoints.shape[1]] * len(rows.steps)))
    for side, edges in rows.edges.items():
        entity = f"{entities.WIREFRAME_3D}/{side.value}"
        rows.once(entity, **line_style(3, SIDE_COLOURS[side], _LINE))
        rows.strips(entity, rr.LineStrips3D, rows.keypoints[:, edges])
    rows.once(entities.PREVIOUS_3D, **line_style(3, (*style.PREVIOUS, _FAINT), 0.6))
    before = rows.keypoints_in_camera[rows.previous]
    rows.strips(entities.PREVIOUS_3D, rr.LineStrips3D, before[:, result.shape.edges])


def _log_planes(rows: Rows) -> None:
    """The planes of the faces, and the medial plane."""
    result = rows.plays[0].vehicle.reconstruction
    outlines = face_outlines(rows.keypoints, result.shape.faces)
    if len(result.shape.symmetric_pairs):
        outlines[entities.MEDIAL] = medial_outlines(rows.keypoints, result.shape.symmetric_pairs)
    for index, (name, outline) in enumerate(outlines.items()):
        corners = outline.shape[1]
        entity = f"{entities.PLANES}/{name}"
        colour = (*style.plane_colour(index), _PLANE_ALPHA)
        rows.once(entity, rr.Mesh3D, triangle_indices=fan(corners), albedo_factor=colour)
        mesh = rr.Mesh3D.columns(vertex_positions=outline.reshape(-1, 3)).partition([corners] * len(outline))
        rows.send(entity, mesh)


def log_ground(play: Playback, ground: Ground | None) -> None:
    """A grid on the ground around the result."""
    grid = ground_grid(play.vehicle.reconstruction.camera_T_object, ground)
    look = fixed_columns(**line_style(3, style.GROUND, 0.4))
    play.always(entities.GROUND, [*look, *strip_columns(rr.LineStrips3D, grid[None])])


def log_result(play: Playback) -> None:
    """What only the result has: surface, box, uncertainty of the keypoints."""
    result = play.vehicle.reconstruction
    play.once(entities.VEHICLE_BOX, **line_style(3, style.SCREEN_INK, 0.75))
    corners = outline_corners(result.box_size)[None, BOX_EDGES]
    play.at_result(entities.VEHICLE_BOX, strip_columns(rr.LineStrips3D, corners))
    if result.shape.surface_vertices is not None and result.shape.surface_faces is not None:
        colour = (*SURFACE, _SURFACE_ALPHA)
        _log_mesh(play, entities.SURFACE, result.shape.surface_vertices, result.shape.surface_faces, colour)
    if len(result.diagnostics.points):
        _log_points(play)
    if others := [one for one in result.uncertainty.alternatives if not one.probability < _LEAST_PROBABILITY]:
        _log_alternatives(play, others)
    if result.uncertainty.keypoint_covariance is not None:
        log_ellipsoids(
            play, entities.UNCERTAINTY, result.wireframe, result.uncertainty.keypoint_covariance, line_radii=-0.5
        )


def _log_alternatives(play: Playback, others: Sequence[Alternative]) -> None:
    """Where other poses are and which way they face, with how probable they are; their sizes are not known here."""
    nose = np.array([(0.0, 0.0, 0.0), (play.vehicle.reconstruction.box_size[0] / 2 + NOSE, 0.0, 0.0)])
    ends = np.array([transform(one.camera_T_object, nose) for one in others])
    words = [f"{100 * one.probability:.0f} %" if np.isfinite(one.probability) else "?" for one in others]
    play.once(entities.ALTERNATIVES, rr.Arrows3D, colors=style.ALTERNATIVE, radii=-1.5, show_labels=True)
    arrows = rr.Arrows3D.columns(origins=ends[:, 0], vectors=ends[:, 1] - ends[:, 0], labels=words)
    play.at_result(entities.ALTERNATIVES, arrows.partition([len(others)]))


def _log_points(play: Playback) -> None:
    """The points of other sensors in space and in the image, colour by weight."""
    known, camera = play.vehicle.reconstruction.diagnostics, play.vehicle.camera
    colours, count = style.weight_colours(known.point_weights), len(known.points)
    play.once(entities.POINTS_3D, rr.Points3D, radii=-2.0)
    points = rr.Points3D.columns(positions=known.points, colors=colours)
    play.at_result(entities.POINTS_3D, points.partition([count]))
    pixels = image_points(camera, np.eye(4), known.points)
    measured = np.isfinite(pixels).all(axis=1)
    play.once(entities.POINTS_2D, rr.Points2D, radii=-1.5, draw_order=15.0)
    flat = rr.Points2D.columns(positions=pixels[measured], colors=colours[measured])
    play.at_result(entities.POINTS_2D, flat.partition([int(measured.sum())]))


def log_ellipsoids(
    play: Playback,
    entity: str,
    centres: Array,
    covariances: Array,
    *,
    line_radii: float,
    deviations: float = 1.0,
) -> None:
    """Ellipsoids of covariances (M, 3, 3) about centres (M, 3), that many standard deviations large."""
    axes, rotations = ellipsoids(covariances)
    look = {"colors": style.UNCERTAINTY, "fill_mode": "MajorWireframe", "line_radii": line_radii}
    play.once(entity, rr.Ellipsoids3D, **look)
    sizes = rr.Ellipsoids3D.columns(half_sizes=deviations * axes).partition([len(axes)])
    places = rr.InstancePoses3D.columns(translations=centres, mat3x3=rotations).partition([len(axes)])
    play.at_result(entity, [*sizes, *places])


def _log_mesh(play: Playback, entity: str, vertices: Array, faces: NDArray[np.int64], colour: tuple[int, ...]) -> None:
    play.once(entity, rr.Mesh3D, albedo_factor=colour)
    normals = vertex_normals(vertices, faces)
    corners = rr.Mesh3D.columns(vertex_positions=vertices, vertex_normals=normals).partition([len(vertices)])
    play.at_result(entity, [*corners, *rr.Mesh3D.columns(triangle_indices=faces).partition([len(faces)])])
