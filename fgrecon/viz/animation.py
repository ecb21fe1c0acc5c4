"""Animations of an optimisation without a viewer: the image, the view from above and the energy, step by step."""

from __future__ import annotations

import io
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.arrays import Array
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.geometry import transform
from fgrecon.core.reconstruction import Iteration, Reconstruction
from fgrecon.io.files import check_ending, write_bytes
from fgrecon.io.video_frames import check_video, write_video
from fgrecon.viz import style
from fgrecon.viz.describe import describe_errors, total_energy
from fgrecon.viz.geometry import BOX_EDGES, crop_around, image_points, outline_corners
from fgrecon.viz.marks import draw_box, draw_crop, draw_edges, draw_grid, draw_keypoints, draw_true_box, unit
from fgrecon.viz.picture import as_rgb, new_figure, place_axes
from fgrecon.viz.subjects import SolvedVehicle, Truth

FORMATS = ("gif", "mp4")
"""File types that `animate` writes, by the ending of the name."""

_DPI = 100
_WIDTH, _HEIGHT, _PANEL, _LOW = 9.0, 3.2, 2.72, 0.1  # inches
_ASPECT = 1.5
_PER_SECOND = 6
_START, _HOLD = 5, 12  # frames that the start and the result stay
_REACH, _FARTHEST = 3.4, 12.0  # metres around the result that the view from above shows; and as many as the start asks


def check_format(path: str | Path) -> str:
    """The ending of the name, in lower case.

    Raises:
        InvalidInputError: Nothing is written with that ending, or there is no encoder for it.
        MissingPackageError: A package for it is not installed.
    """
    kind = check_ending(path, FORMATS)
    if kind == "mp4":
        check_video(path)
    return kind


def animate(path: str | Path, vehicle: SolvedVehicle) -> Path:
    """Write an animation of an optimisation, whole or not at all.

    Args:
        path: `.gif` or `.mp4` file to write.
        vehicle: The vehicle; the history of its result is what is shown, a truth is drawn in green.

    Returns:
        The path written to.

    Raises:
        InvalidInputError: Another ending, a result without a history, an image that is not (H, W, 3) of bytes, or the
            file cannot be written.
        MissingPackageError: It is an MP4, and PyAV is not installed.
    """
    kind = check_format(path)
    if not vehicle.reconstruction.diagnostics.history:
        raise InvalidInputError("history", "empty", "Reconstruct with keep_history=True.")
    frames = list(_frames(vehicle))
    return write_bytes(path, _gif(frames)) if kind == "gif" else _mp4(path, frames)


def _frames(vehicle: SolvedVehicle) -> Iterator[NDArray[np.uint8]]:
    """One picture per step. What does not move is drawn once."""
    result, observation, truth = vehicle.reconstruction, vehicle.observation, vehicle.truth
    figure = new_figure(_WIDTH, _HEIGHT)
    photo = place_axes(figure, 0.08, _LOW, _PANEL * _ASPECT, _PANEL)
    draw_crop(photo, vehicle.pixels, vehicle.camera, crop_around(observation, result.pose.wireframe_uv, aspect=_ASPECT))
    if observation.box is not None:
        draw_box(photo, observation.box)
    above = place_axes(figure, 4.72, 0.5, 2.0, _PANEL - 0.4)
    _draw_ground(above, result, truth)
    if truth is not None:
        draw_true_box(photo, truth, vehicle.camera)
    energy = place_axes(figure, 7.25, 0.5, 1.65, _PANEL - 0.4)
    totals = _prepare_energy(energy, result)
    heading = figure.text(0.1 / _WIDTH, 1 - 0.2 / _HEIGHT, "", fontsize=9, va="center", parse_math=False)
    edges = style.edges_by_side(result)
    for row, step in enumerate(result.diagnostics.history):
        fixed = {axes: set(axes.get_children()) for axes in (photo, above, energy)}
        projections = image_points(vehicle.camera, step.camera_T_object, step.keypoints)
        draw_edges(photo, projections, edges)
        draw_keypoints(photo, observation, step.weights, projections)
        draw_edges(above, transform(step.camera_T_object, step.keypoints)[:, [0, 2]], edges)
        energy.plot(totals[: row + 1], color=unit(style.INK), linewidth=1.2)
        energy.plot(row, totals[row], "o", color=unit(style.INK), markersize=3)
        heading.set_text(_heading(step, truth))
        yield as_rgb(figure, _DPI)
        for axes, kept in fixed.items():
            for artist in set(axes.get_children()) - kept:
                artist.remove()


def _heading(step: Iteration, truth: Truth | None) -> str:
    text = f"{step.stage.capitalize()}, weight update {step.irls}, step {step.step}"
    return text if truth is None else f"{text}; off by {describe_errors(truth, step.camera_T_object, step.keypoints)}"


def _draw_ground(axes: Any, result: Reconstruction, truth: Truth | None) -> None:
    """The view from above, around the result, with the box of the truth."""
    x, _, z = np.nan_to_num(result.location)
    if truth is not None and truth.box_size is not None:
        corners = transform(truth.camera_T_object, outline_corners(truth.box_size)[BOX_EDGES[:4, 0]])[[0, 1, 2, 3, 0]]
        axes.plot(corners[:, 0], corners[:, 2], color=unit(style.TRUTH), linewidth=1.2, zorder=2)
    start = result.diagnostics.history[0]
    away = transform(start.camera_T_object, start.keypoints)[:, [0, 2]] - (x, z)
    reach = float(np.clip(1.05 * np.abs(away).max(), _REACH, _FARTHEST))
    axes.set_xlim(x - reach, x + reach)
    axes.set_ylim(z - reach, z + reach)
    axes.set_aspect("equal")
    axes.set_title("From above [m]", fontsize=8, loc="left", pad=3)
    draw_grid(axes)


def _prepare_energy(axes: Any, result: Reconstruction) -> Array:
    """Axes for the energy, as large as all of it; (n,) totals."""
    totals = np.array([total_energy(step) for step in result.diagnostics.history])
    finite = totals[np.isfinite(totals)]
    low, high = (float(finite.min()), float(finite.max())) if len(finite) else (0.0, 1.0)
    margin = 0.06 * max(high - low, 1e-3)
    axes.set_xlim(-0.5, len(totals) - 0.5)
    axes.set_ylim(low - margin, high + margin)
    axes.set_title("Energy [nats] by step", fontsize=8, loc="left", pad=3)
    draw_grid(axes)
    return totals


def _gif(frames: list[NDArray[np.uint8]]) -> bytes:
    """All frames in the same 256 colours, those of the first and the last: with palettes of their own they flicker."""
    from PIL import Image  # matplotlib brings it

    both = Image.fromarray(np.concatenate([frames[0], frames[-1]]))
    palette = both.quantize(256, method=Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE)
    pictures = [Image.fromarray(frame).quantize(palette=palette, dither=Image.Dither.NONE) for frame in frames]
    shown = [_START, *[1] * (len(pictures) - 2), _HOLD][-len(pictures) :]
    duration = [1000 * count // _PER_SECOND for count in shown]
    content = io.BytesIO()
    pictures[0].save(content, "GIF", save_all=True, append_images=pictures[1:], duration=duration, loop=0)
    return content.getvalue()


def _mp4(path: str | Path, frames: list[NDArray[np.uint8]]) -> Path:
    with write_video(path, rate=_PER_SECOND) as add:
        for frame in [*[frames[0]] * (_START - 1), *frames, *[frames[-1]] * _HOLD]:
            add(frame, None)
    return Path(path)
