"""The plotting backend of `Reconstruction.plot` and notebooks, found by its entry point.

A result knows neither its camera nor what it was solved from: its final wireframe is drawn. `fgrecon.viz.picture` draws
the stages as well, where both are given.
"""

from __future__ import annotations

import base64
import io
import textwrap
from collections.abc import Sequence
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.errors import InvalidInputError
from fgrecon.core.observation import Observation
from fgrecon.core.reconstruction import TRUSTED, Reconstruction
from fgrecon.core.track_reconstruction import TrackReconstruction
from fgrecon.io.images import read_image
from fgrecon.viz import style
from fgrecon.viz.geometry import as_image, crop_around
from fgrecon.viz.marks import draw_box, draw_crop, draw_edges, draw_keypoints, unit
from fgrecon.viz.picture import CELL_ASPECT, new_figure, new_sheet, place_axes
from fgrecon.viz.solid import draw_from_above, draw_three_quarter

_GAP, _HEADING, _FOOT = 0.1, 0.3, 0.8  # inches, as all sizes here
_WIDTH, _HEIGHT, _SOLID, _ABOVE = 3.4, 2.3, 2.2, 2.0
_COLUMNS, _CELL = 4, 2.6
_SHOWN = 12
"""Images of a track that a notebook shows at most, spread over it."""


def plot(
    result: Reconstruction,
    image: NDArray[np.uint8] | str | Path | None = None,
    *,
    observation: Observation | None = None,
) -> Any:
    """The final wireframe over the image, in 3D and from above, with a caption.

    Args:
        result: What is drawn.
        image: (H, W, 3) RGB photograph, or its file; without one there is a plain canvas.
        observation: The keypoints that it was solved from, to be drawn as well.

    Returns:
        A `matplotlib.figure.Figure` with an Agg canvas.

    Raises:
        InvalidInputError: The image is none, or the observation is of another category.
    """
    photograph = _photograph(image)
    if observation is not None and len(observation.keypoints) != len(result.diagnostics.weights):
        fix = f"Give one of {len(result.diagnostics.weights)} keypoints."
        raise InvalidInputError("observation", f"{len(observation.keypoints)} keypoints", fix)
    figure = new_figure(_WIDTH + _SOLID + _ABOVE + 6 * _GAP, _HEIGHT + _HEADING + _FOOT)
    axes = place_axes(figure, _GAP, _FOOT, _WIDTH, _HEIGHT)
    _draw_over(axes, result, photograph, observation, _WIDTH / _HEIGHT)
    axes.set_title("Result" if _solved(result) else "No pose", fontsize=9, loc="left")
    if _solved(result):
        edges = style.edges_by_side(result)
        solid = place_axes(figure, _WIDTH + 2 * _GAP, _FOOT, _SOLID, _HEIGHT)
        solid.set_title(f"In 3D, from the {draw_three_quarter(solid, result, edges)}", fontsize=9, loc="left")
        above = place_axes(figure, _WIDTH + _SOLID + 6 * _GAP, _FOOT + 0.25, _ABOVE - _GAP, _HEIGHT - 0.25)
        draw_from_above(above, result, edges, None)
        above.set_title("From above", fontsize=9, loc="left")
    words = "\n".join(textwrap.shorten(line, 170) for line in repr(result).splitlines())
    height = figure.get_size_inches()[1]
    figure.text(0.012, (_FOOT - 0.28) / height, words, fontsize=7, color=unit(style.INK), va="top", parse_math=False)
    return figure


def plot_track(track: TrackReconstruction, images: Sequence[NDArray[np.uint8] | str | Path] | None = None) -> Any:
    """The wireframe over every image that was solved.

    Args:
        track: What is drawn.
        images: Photograph, or its file, of each observation; without them there is a plain canvas.

    Returns:
        A `matplotlib.figure.Figure` with an Agg canvas.

    Raises:
        InvalidInputError: An image is none, or there are fewer than observations.
    """
    if images is not None and len(images) <= max(track.numbers):
        fix = f"Give one for each observation, at least {max(track.numbers) + 1}."
        raise InvalidInputError("images", f"{len(images)} images", fix)
    return _sheet(track, range(len(track.frames)), images)


def html(result: Reconstruction | TrackReconstruction) -> str:
    """The picture and a small table; of a long track some of the images."""
    if isinstance(result, TrackReconstruction):
        count = len(result.frames)
        figure = _sheet(result, np.unique(np.linspace(0, count - 1, min(count, _SHOWN)).astype(int)).tolist(), None)
        rows = _track_rows(result)
    else:
        figure, rows = plot(result), _rows(result)
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=100)
    picture = base64.b64encode(buffer.getvalue()).decode("ascii")
    cells = "".join(f"<tr><th>{escape(name)}</th><td>{escape(value)}</td></tr>" for name, value in rows)
    image = f'<img alt="result" style="max-width: 100%" src="data:image/png;base64,{picture}">'
    return f"<div>{image}<table>{cells}</table></div>"


def _sheet(
    track: TrackReconstruction, chosen: Sequence[int], images: Sequence[NDArray[np.uint8] | str | Path] | None
) -> Any:
    figure, cells = new_sheet("frames", len(chosen), _COLUMNS, _HEADING, cell=_CELL, gap=_GAP)
    for axes, index in zip(cells, chosen, strict=True):
        number, frame = track.numbers[index], track.frames[index]
        _draw_over(axes, frame, None if images is None else _photograph(images[number]), None, CELL_ASPECT)
        axes.set_title(f"{number}: {frame.status.value}", fontsize=8, loc="left")
    return figure


def _draw_over(
    axes: Any, result: Reconstruction, image: NDArray[np.uint8] | None, observation: Observation | None, aspect: float
) -> None:
    """The wireframe over the part of the image where it is; without an observation its keypoints by their weight."""
    count = len(result.diagnostics.weights)
    nothing = Observation(np.full((count, 2), np.nan), np.zeros(count))
    crop = crop_around(observation or nothing, result.pose.wireframe_uv, aspect=aspect)
    draw_crop(axes, image, None, crop)
    if observation is not None and observation.box is not None:
        draw_box(axes, observation.box)
    if _solved(result):
        draw_edges(axes, result.pose.wireframe_uv, style.edges_by_side(result))
    if observation is not None:
        draw_keypoints(
            axes, observation, result.diagnostics.weights, result.pose.wireframe_uv if _solved(result) else None
        )
    elif _solved(result):
        draw_keypoints(axes, Observation(result.pose.wireframe_uv, np.ones(count)), result.diagnostics.weights, None)


def _photograph(image: NDArray[np.uint8] | str | Path | None) -> NDArray[np.uint8] | None:
    if image is None:
        return None
    return read_image(image) if isinstance(image, str | Path) else as_image(image)


def _solved(result: Reconstruction) -> bool:
    return bool(np.isfinite(result.camera_T_object).all())


def _rows(result: Reconstruction) -> list[tuple[str, str]]:
    x, y, z = result.location
    length, width, height = result.box_size
    time = sum(result.diagnostics.milliseconds.values())
    return [
        ("status", f"{result.status.value}: {result.message}"),
        ("rotation_y", f"{np.degrees(result.rotation_y):.1f}°"),
        ("location", f"{x:.2f}, {y:.2f}, {z:.2f} m"),
        ("length, width, height", f"{length:.2f}, {width:.2f}, {height:.2f} m"),
        (
            "keypoints trusted",
            f"{np.count_nonzero(result.diagnostics.weights >= TRUSTED)} of {len(result.diagnostics.weights)}",
        ),
        ("other poses", str(len(result.uncertainty.alternatives))),
        *([("time", f"{time:.0f} ms")] if time else []),  # with others of an image it is theirs as well
    ]


def _track_rows(track: TrackReconstruction) -> list[tuple[str, str]]:
    length, width, height = track.box_size
    return [
        ("status", f"{track.status.value}: {track.message}"),
        ("images", f"{len(track.frames)} solved, {len(track.refused)} refused"),
        ("length, width, height", f"{length:.2f}, {width:.2f}, {height:.2f} m"),
        ("time", f"{sum(track.milliseconds.values()):.0f} ms"),
    ]
