"""Frames of a video with what was found in them: wireframes, boxes, names, and a view from above in the corner.

Drawn with OpenCV into the pixels, in a few milliseconds a frame.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.camera import Camera
from fgrecon.core.geometry import transform
from fgrecon.core.reconstruction import Reconstruction
from fgrecon.core.vehicle_mesh import VehicleMesh
from fgrecon.viz import style
from fgrecon.viz.geometry import BOX_EDGES, as_image, image_points, outline_corners
from fgrecon.viz.truth import Truth

__all__ = ["Shown", "annotated"]

_REACH, _BESIDE, _BEHIND = 50.0, 28.0, 3.0  # metres that the view from above shows ahead, to each side, and behind
_SHARE = 0.55  # of the image's height that it takes at most
_RING = 10.0  # metres between its lines
_LONG = 30  # frames of a trail
_CASED = 60.0  # pixels of a box's width from which its wireframe has a casing


@dataclass(frozen=True, eq=False)
class Shown:
    """One vehicle of a frame.

    Attributes:
        identity: Its id, which is its colour as well.
        box: (4,) 2D box in pixels.
        result: The reconstruction; None draws the 2D box alone.
        words: What is written beside its id, such as its speed.
        trail: (T, 3) where it was, in this camera's frame, oldest first; none where that is not known.
        name: What it is called where its id is not its name.
        truth: What is known to be true.
        model: The car model that it comes nearest to.
    """

    identity: int
    box: NDArray[np.float64]
    result: Reconstruction | None = None
    words: str = ""
    trail: NDArray[np.float64] | None = None
    name: str = ""
    truth: Truth | None = None
    model: VehicleMesh | None = None

    @property
    def pose(self) -> NDArray[np.float64] | None:
        """(4, 4) `camera_T_object`, or None where it has no pose."""
        found = self.result is not None and np.isfinite(self.result.camera_T_object).all()
        return self.result.camera_T_object if self.result is not None and found else None


def annotated(
    image: NDArray[np.uint8], vehicles: Sequence[Shown], camera: Camera, *, caption: str = ""
) -> NDArray[np.uint8]:
    """A copy of an image (H, W, 3) with vehicles drawn into it, far ones first.

    Args:
        image: RGB bytes.
        vehicles: What it shows.
        camera: The camera that took it.
        caption: Text in the upper left corner.

    Raises:
        InvalidInputError: It is no image.
    """
    canvas = as_image(image).copy()
    width = max(1, round(canvas.shape[0] / 400))
    for vehicle in sorted(vehicles, key=_depth, reverse=True):
        _draw_vehicle(canvas, vehicle, camera, width)
    if any(vehicle.result is not None for vehicle in vehicles):
        _draw_above(canvas, vehicles)
    if caption:
        _write(canvas, caption, (6, 6), style.PAPER, style.INK)
    return canvas


def _depth(vehicle: Shown) -> float:
    return np.inf if vehicle.result is None else float(vehicle.result.location[2])


def _draw_vehicle(canvas: NDArray[np.uint8], vehicle: Shown, camera: Camera, width: int) -> None:
    colour = style.categorical(vehicle.identity)
    x1, y1, x2, y2 = vehicle.box
    _lines(canvas, np.array([[(x1, y1), (x2, y1), (x2, y2), (x1, y2), (x1, y1)]]), colour, 1)
    if vehicle.result is not None and vehicle.pose is not None:
        result = vehicle.result
        corners = image_points(camera, result.camera_T_object, outline_corners(result.box_size))
        _lines(canvas, corners[BOX_EDGES[:4]], colour, width)
        wireframe = image_points(camera, result.camera_T_object, result.wireframe)
        if x2 - x1 > _CASED:
            _lines(canvas, wireframe[result.edges], style.PAPER, width + 2)
        _lines(canvas, wireframe[result.edges], colour, width)
    text = f"{vehicle.identity} {vehicle.words}".strip()
    _write(canvas, text, (max(round(x1), 0), max(round(y1) - 14, 0)), colour, style.PAPER)


def _draw_above(canvas: NDArray[np.uint8], vehicles: Sequence[Shown]) -> None:
    """The view from above, in the lower right corner, darkened."""
    import cv2

    height = int(_SHARE * canvas.shape[0])
    scale = height / (_REACH + _BEHIND)  # pixels a metre
    wide = min(int(2 * _BESIDE * scale), canvas.shape[1])
    panel = canvas[-height:, -wide:]
    panel[:] = panel // 4

    def at(points: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.stack([wide / 2 + points[:, 0] * scale, height - (points[:, -1] + _BEHIND) * scale], axis=1)

    grey = style.FADED
    for ring in np.arange(_RING, _REACH + 1, _RING):
        middle = at(np.array([[0.0, 0.0]]))[0]
        cv2.circle(panel, (int(middle[0]), int(middle[1])), int(ring * scale), grey, 1, cv2.LINE_AA)
    for vehicle in vehicles:
        if vehicle.result is None or vehicle.pose is None:
            continue
        colour = style.categorical(vehicle.identity)
        corners = outline_corners(vehicle.result.box_size)[:4]
        ahead = np.array([[0.5 * vehicle.result.box_size[0], 0, 0], [0.5 * vehicle.result.box_size[0] + 1.5, 0, 0]])
        outline = at(transform(vehicle.result.camera_T_object, corners))
        _lines(panel, outline[[0, 1, 2, 3, 0]][None], colour, 2)
        _lines(panel, at(transform(vehicle.result.camera_T_object, ahead))[None], colour, 2)
        if vehicle.trail is not None and len(vehicle.trail) > 1:
            _lines(panel, at(vehicle.trail[-_LONG:])[None], colour, 1)


def _lines(canvas: NDArray[np.uint8], lines: NDArray[np.float64], colour: style.Colour, width: int) -> None:
    """Draw lines (L, P, 2) of pixels; those with a point that is not seen are left out."""
    import cv2

    kept = [line for line in lines if np.isfinite(line).all() and np.abs(line).max() < 3e4]
    sharp = 3  # bits behind the point
    paths: Any = [np.rint(line * 2**sharp).astype(np.int32)[:, None] for line in kept]
    cv2.polylines(canvas, paths, isClosed=False, color=colour, thickness=width, lineType=cv2.LINE_AA, shift=sharp)


def _write(
    canvas: NDArray[np.uint8], text: str, corner: tuple[int, int], paper: style.Colour, ink: style.Colour
) -> None:
    """Write a text on a small plate whose upper left corner is given."""
    import cv2

    face, size = cv2.FONT_HERSHEY_SIMPLEX, 0.4
    (wide, high), below = cv2.getTextSize(text, face, size, 1)
    x, y = min(corner[0], max(canvas.shape[1] - wide - 2, 0)), corner[1]
    cv2.rectangle(canvas, (x, y), (x + wide + 2, y + high + below), paper, -1)
    cv2.putText(canvas, text, (x + 1, y + high), face, size, ink, 1, cv2.LINE_AA)
