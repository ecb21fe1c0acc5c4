"""Recordings of a reconstruction for the rerun viewer, made from its history after solving.

`record` writes a file, whole or not at all; `recording_of` gives the same to be sent to any recording stream (a viewer
that runs, a file that holds more). The names are those of `fgrecon.viz.entities`; `fgrecon.viz.replay` reads a file
back. `fgrecon.viz.track_recording` does the same for a track.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.camera import Camera, Ground
from fgrecon.core.observation import Observation
from fgrecon.core.reconstruction import Reconstruction
from fgrecon.core.vehicle_mesh import VehicleMesh
from fgrecon.viz.columns import Outbox
from fgrecon.viz.factor_graph import log_graph
from fgrecon.viz.photograph import Photograph
from fgrecon.viz.playback import Playback, Rows
from fgrecon.viz.plots import log_history, log_plots, log_words
from fgrecon.viz.scene import log_camera, log_frame, log_ground, log_model, log_result, log_steps, log_truth
from fgrecon.viz.sinks import Recording
from fgrecon.viz.truth import Truth

__all__ = ["log_vehicle", "record", "recording_of"]


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
    return recording_of(reconstruction, observation, camera, image=image, truth=truth, ground=ground).write(path)


def recording_of(
    reconstruction: Reconstruction,
    observation: Observation,
    camera: Camera,
    *,
    image: NDArray[np.uint8] | Photograph | None = None,
    truth: Truth | None = None,
    ground: Ground | None = None,
    model: VehicleMesh | None = None,
) -> Recording:
    """The recording that `record` writes, to be sent elsewhere; the arguments are those of `record`.

    A `Photograph` that several recordings share is encoded once. `model` is the closest car model, shown instead of the
    surface.
    """
    from fgrecon.viz.blueprint import blueprint

    def make() -> Callable[[Any], None]:
        return _outbox(reconstruction, observation, camera, image, truth, ground, model).empty_into

    return Recording(make, lambda: blueprint(reconstruction, observation, truth, model=model is not None))


def _outbox(
    reconstruction: Reconstruction,
    observation: Observation,
    camera: Camera,
    image: NDArray[np.uint8] | Photograph | None,
    truth: Truth | None,
    ground: Ground | None,
    model: VehicleMesh | None,
) -> Outbox:
    """All chunks of a recording."""
    photograph = Photograph.of(image)
    out = Outbox(f"{reconstruction.category}, {reconstruction.status.value}")
    play = Playback(out, reconstruction, observation, camera, truth)
    log_camera(play, photograph)
    log_frame(play, photograph)
    log_vehicle(play, model)
    if np.isfinite(reconstruction.camera_T_object).all():
        log_ground(play, ground)
    return out


def log_vehicle(play: Playback, model: VehicleMesh | None = None) -> None:
    """All about a vehicle that does not depend on where it is seen.

    That is truth, every step, result, closest car model, plots, graph and words.
    """
    if play.truth is not None:
        log_truth(play, play.truth)
    if play.steps:
        rows = Rows.of([play])
        log_steps(rows)
        log_plots(play)
        log_graph(play)
        if play.reconstruction.history:
            log_history(rows)
    if np.isfinite(play.reconstruction.camera_T_object).all():
        log_result(play)
        if model is not None:
            log_model(play, model)
    log_words(play)
