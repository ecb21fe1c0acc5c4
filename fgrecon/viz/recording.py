"""Recordings of a reconstruction for the rerun viewer, made from its history after solving.

`record` writes a file, whole or not at all; `log_reconstruction` sends the same to any recording stream (a viewer that
runs, a file that holds more). The names are those of `fgrecon.viz.entities`; `fgrecon.replay` reads a file back.
"""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgrecon.camera import Camera, Ground
from fgrecon.files import write_bytes
from fgrecon.observation import Observation
from fgrecon.reconstruction import Reconstruction
from fgrecon.viz import entities, style
from fgrecon.viz.geometry import (
    BOX_EDGES,
    as_image,
    box_corners,
    ellipsoids,
    ground_grid,
    image_points,
    resolution,
    vertex_normals,
)
from fgrecon.viz.playback import Playback
from fgrecon.viz.plots import log_history, log_plots, log_words
from fgrecon.viz.truth import Truth

__all__ = ["APPLICATION", "log_reconstruction", "record"]

APPLICATION = "fgrecon"
"""First part of the application that a recording names; the second is the file's name. Viewers keep one layout per
application, and ours zooms to the vehicle: two recordings in one viewer must not share it."""

_JPEG_QUALITY = 92
_SURFACE_ALPHA = 150  # of 255: the wireframe shows through
_IMAGE_PLANE = 0.15  # distance of the drawn image plane from the camera, relative to the vehicle's distance
_LINE = 1.25  # half width of the lines that matter; negative radii are in points of the screen


def record(
    path: str | Path,
    reconstruction: Reconstruction,
    observation: Observation,
    camera: Camera,
    *,
    image: NDArray[np.uint8] | None = None,
    truth: Truth | None = None,
    ground: Ground | None = None,
) -> Path:
    """Write a recording of the whole optimisation, with its layout, to a `.rrd` file, whole or not at all.

    Args:
        path: File to write.
        reconstruction: The result; its history is what is played back.
        observation: The keypoints that it was solved from.
        camera: The camera that saw them.
        image: (H, W, 3) RGB photograph, or None.
        truth: What is known to be true, drawn beside the estimate and plotted as errors.
        ground: The ground plane that was assumed; without one the grid lies below the vehicle.

    Returns:
        The path written to.

    Raises:
        InvalidInputError: The file cannot be written, or the image is not (H, W, 3) of bytes.
    """
    import rerun as rr  # on use: importing fgrecon must not import rerun

    from fgrecon.viz.blueprint import blueprint

    stream = rr.RecordingStream(f"{APPLICATION}: {Path(path).stem}")
    with tempfile.TemporaryDirectory() as folder:
        part = Path(folder) / "recording.rrd"
        stream.save(part, default_blueprint=blueprint(reconstruction, observation, truth))
        log_reconstruction(stream, reconstruction, observation, camera, image=image, truth=truth, ground=ground)
        stream.flush()
        stream.disconnect()
        return write_bytes(path, part.read_bytes())


def log_reconstruction(
    stream: Any,
    reconstruction: Reconstruction,
    observation: Observation,
    camera: Camera,
    *,
    image: NDArray[np.uint8] | None = None,
    truth: Truth | None = None,
    ground: Ground | None = None,
) -> None:
    """Send the whole optimisation to a `rerun.RecordingStream`; the arguments are those of `record`.

    Raises:
        InvalidInputError: The image is not (H, W, 3) of bytes.
    """
    photograph = None if image is None else as_image(image)
    play = Playback(stream, reconstruction, observation, camera, truth)
    stream.send_recording_name(f"{reconstruction.category}, {reconstruction.status.value}")
    _log_camera(play, photograph)
    if truth is not None:
        _log_truth(play, truth)
    if play.steps:
        _log_image_steps(play)
        _log_scene_steps(play)
        log_plots(play)
    if reconstruction.history:
        log_history(play)
    if np.isfinite(reconstruction.camera_T_object).all():
        _log_result(play, ground)
    log_words(play)


def _log_camera(play: Playback, image: NDArray[np.uint8] | None) -> None:
    """The camera with its photograph, and the styles of what its image plane shows."""
    import rerun as rr

    depth = play.reconstruction.location[2]
    distance = _IMAGE_PLANE * (depth if np.isfinite(depth) and depth > 0 else 10.0)
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
    if image is not None:
        play.once(entities.IMAGE, rr.EncodedImage(contents=_jpeg(image), media_type="image/jpeg", draw_order=-10.0))
    box = play.observation.box
    if box is not None:
        play.once(
            entities.BOX_2D,
            rr.Boxes2D(array=box, array_format=rr.Box2DFormat.XYXY, colors=style.SCREEN_INK, radii=-0.5),
        )


def _jpeg(image: NDArray[np.uint8]) -> bytes:
    import cv2

    bgr = np.ascontiguousarray(image[..., ::-1])
    return bytes(cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])[1])


def _log_truth(play: Playback, truth: Truth) -> None:
    """The true box and keypoints, in 3D and in the image."""
    import rerun as rr

    pose = truth.camera_T_object
    play.once(entities.TRUTH_3D, rr.Transform3D(translation=pose[:3, 3], mat3x3=pose[:3, :3]))
    if truth.box_size is not None:
        corners = box_corners(truth.box_size)
        pixels = image_points(play.camera, pose, corners)[BOX_EDGES]
        seen = np.isfinite(pixels).all(axis=(1, 2))
        play.once(f"{entities.TRUTH_3D}/box", rr.LineStrips3D(corners[BOX_EDGES], colors=style.TRUTH, radii=-_LINE))
        play.once(entities.TRUTH_2D, rr.LineStrips2D(pixels[seen], colors=style.TRUTH, radii=-0.75, draw_order=5.0))
    if truth.keypoints is not None:
        known = np.isfinite(truth.keypoints).all(axis=1)
        play.once(f"{entities.TRUTH_3D}/keypoints", rr.Points3D(truth.keypoints[known], colors=style.TRUTH, radii=-3.0))


def _log_image_steps(play: Playback) -> None:
    """What the image shows at every step: keypoints by weight, projected wireframe, residuals."""
    import rerun as rr

    measured = np.flatnonzero(play.observation.measured)
    detected = play.observation.keypoints[measured]
    names = [play.reconstruction.keypoint_names[i] for i in measured]

    if len(measured):
        play.once(entities.KEYPOINTS_2D, rr.Points2D.from_fields(labels=names, show_labels=False, draw_order=30.0))
        weights = play.weights[:, measured]
        columns = rr.Points2D.columns(
            positions=np.tile(detected, (len(weights), 1)),
            colors=style.weight_colours(weights).reshape(-1, 3),
            radii=-style.weight_radii(weights).ravel(),
        )
        play.every_step(entities.KEYPOINTS_2D, columns.partition([len(measured)] * len(weights)))
        residuals = np.stack([np.broadcast_to(detected, play.pixels[:, measured].shape), play.pixels[:, measured]], 2)
        play.once(
            entities.RESIDUALS, rr.LineStrips2D.from_fields(colors=style.SCREEN_INK, radii=-0.75, draw_order=20.0)
        )
        play.strips(entities.RESIDUALS, rr.LineStrips2D, residuals)
    for side, edges in play.edges.items():
        entity = f"{entities.WIREFRAME_2D}/{side.value}"
        play.once(entity, rr.LineStrips2D.from_fields(colors=style.SIDE_COLOURS[side], radii=-_LINE, draw_order=10.0))
        play.strips(entity, rr.LineStrips2D, play.pixels[:, edges])


def _log_scene_steps(play: Playback) -> None:
    """What the 3D scene shows at every step: pose, keypoints by weight, wireframe."""
    import rerun as rr

    poses = np.stack([step.camera_T_object for step in play.steps])
    play.every_step(entities.VEHICLE, rr.Transform3D.columns(translation=poses[:, :3, 3], mat3x3=poses[:, :3, :3]))
    names = play.reconstruction.keypoint_names
    play.once(entities.KEYPOINTS_3D, rr.Points3D.from_fields(labels=names, show_labels=False, radii=-4.0))
    columns = rr.Points3D.columns(
        positions=play.keypoints.reshape(-1, 3), colors=style.weight_colours(play.weights).reshape(-1, 3)
    )
    play.every_step(entities.KEYPOINTS_3D, columns.partition([play.keypoints.shape[1]] * len(poses)))
    for side, edges in play.edges.items():
        entity = f"{entities.WIREFRAME_3D}/{side.value}"
        play.once(entity, rr.LineStrips3D.from_fields(colors=style.SIDE_COLOURS[side], radii=-_LINE))
        play.strips(entity, rr.LineStrips3D, play.keypoints[:, edges])


def _log_result(play: Playback, ground: Ground | None) -> None:
    """What only the result has: surface, box, uncertainty of the keypoints; and the ground below it."""
    import rerun as rr

    result = play.reconstruction
    grid = ground_grid(result.camera_T_object, ground)
    play.once(entities.GROUND, rr.LineStrips3D(grid, colors=style.GROUND, radii=-0.4))
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
