"""Frames of a video with vehicles drawn into them: wireframes, boxes, names, and a view from above beside them.

Drawn with OpenCV into the pixels, in a few milliseconds a frame.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.arrays import Array
from fgrecon.core.camera import Camera
from fgrecon.core.geometry import transform
from fgrecon.core.reconstruction import TRUSTED
from fgrecon.core.vehicle_mesh import Colour
from fgrecon.viz import style
from fgrecon.viz.geometry import BOX_EDGES, as_image, box_path, image_points, outline_corners
from fgrecon.viz.subjects import DrawnVehicle

Rectangle = tuple[int, int, int, int]
"""Left, top, right, bottom in pixels."""

_REACH, _BESIDE, _BEHIND = 50.0, 28.0, 3.0  # metres that the view from above shows ahead, to each side, and behind
_SHARE = 0.5  # of the image's width that it is wide at most
_RING = 10.0  # metres between its lines
_LONG = 30  # frames of a trail
_NOSE = 1.5  # metres that a line goes beyond a vehicle's front
_CASED = 60.0  # pixels of a box's width from which its wireframe has a casing
_RING_TEXT = np.radians(28.0)  # right of ahead, where the rings' distances are written
_FACE_SIZE = 0.4  # of the type, relative to OpenCV's
_HIGHEST = 16  # plates, one above another, that are tried above a box


def annotated(
    image: NDArray[np.uint8], vehicles: Sequence[DrawnVehicle], camera: Camera, *, caption: str = ""
) -> NDArray[np.uint8]:
    """A copy of an image (H, W, 3) with vehicles drawn into it, far ones first, and the view from above on its right.

    Args:
        image: RGB bytes.
        vehicles: What it shows.
        camera: The camera that took it.
        caption: Text in the upper left corner.

    Returns:
        (H, W + P, 3), with the P columns of the view from above the same for all images of a size.

    Raises:
        InvalidInputError: It is no image.
    """
    canvas = as_image(image).copy()
    width = max(1, round(canvas.shape[0] / 400))
    nearest_first = sorted(vehicles, key=_depth)
    for vehicle in reversed(nearest_first):
        _draw_vehicle(canvas, vehicle, camera, width)
    taken = [_write(canvas, caption, (6, 6), style.PAPER, style.INK)] if caption else []
    _write_names(canvas, nearest_first, taken)
    return np.concatenate([canvas, _from_above(canvas.shape[0], canvas.shape[1], vehicles)], axis=1)


def _depth(vehicle: DrawnVehicle) -> float:
    return np.inf if vehicle.pose is None else float(vehicle.pose[2, 3])


def _draw_vehicle(canvas: NDArray[np.uint8], vehicle: DrawnVehicle, camera: Camera, width: int) -> None:
    colour = style.categorical(vehicle.identity)
    _lines(canvas, box_path(vehicle.box)[None], colour, 1)
    if vehicle.result is not None and vehicle.pose is not None:
        result = vehicle.result
        corners = image_points(camera, vehicle.pose, outline_corners(result.box_size))
        _lines(canvas, corners[BOX_EDGES[:4]], colour, width)
        wireframe = image_points(camera, vehicle.pose, result.wireframe)
        if vehicle.box[2] - vehicle.box[0] > _CASED:
            _lines(canvas, wireframe[result.shape.edges], style.PAPER, width + 2)
        _lines(canvas, wireframe[result.shape.edges], colour, width)


def _write_names(canvas: NDArray[np.uint8], vehicles: Sequence[DrawnVehicle], taken: list[Rectangle]) -> None:
    """Write id and words of vehicles above their boxes, the first ones nearest; no plate covers another.

    Args:
        canvas: (H, W, 3), drawn into.
        vehicles: The vehicles, the most important first. Without room the words of one are left out, then its id.
        taken: Where plates are already.
    """
    plates = []
    for vehicle in vehicles:
        x1, y1 = (max(round(float(edge)), 0) for edge in vehicle.box[:2])
        for text in dict.fromkeys((f"{vehicle.label} {vehicle.all_words}".strip(), vehicle.label)):
            wide, high = _plate_size(text)
            left = min(x1, max(canvas.shape[1] - wide, 0))
            tops = [max(y1 - high * step, 0) for step in range(1, _HIGHEST)]
            places = [(left, top, left + wide, top + high) for top in tops]
            place = next((p for p in places if not any(_overlap(p, other) for other in taken)), None)
            if place is not None:
                taken.append(place)
                plates.append((text, place, style.categorical(vehicle.identity), y1))
                break
    for _, (left, _, _, bottom), colour, y in plates:
        if y > bottom:
            _lines(canvas, np.array([[(left + 1, bottom), (left + 1, y)]], dtype=np.float64), colour, 1)
    for text, (left, top, *_), colour, _ in plates:
        _write(canvas, text, (left, top), colour, style.PAPER)


def _overlap(one: Rectangle, other: Rectangle) -> bool:
    return one[0] < other[2] and other[0] < one[2] and one[1] < other[3] and other[1] < one[3]


def _from_above(height: int, width: int, vehicles: Sequence[DrawnVehicle]) -> NDArray[np.uint8]:
    """The view from above as a panel, as high as the image."""
    import cv2

    scale = min(height / (_REACH + _BEHIND), _SHARE * width / (2 * _BESIDE))  # pixels a metre
    wide = max(round(2 * _BESIDE * scale), 1)
    panel = np.full((height, wide, 3), style.INK, dtype=np.uint8)

    def at(points: Array) -> Array:
        return np.stack([wide / 2 + points[:, 0] * scale, height - (points[:, -1] + _BEHIND) * scale], axis=1)

    grey = style.FADED
    for ring in np.arange(_RING, _REACH + 1, _RING):
        middle = at(np.array([[0.0, 0.0]]))[0]
        cv2.circle(panel, (int(middle[0]), int(middle[1])), int(ring * scale), grey, 1, cv2.LINE_AA)
        u, v = at(ring * np.array([[np.sin(_RING_TEXT), np.cos(_RING_TEXT)]]))[0]
        text = f"{ring:.0f} m"
        size = _plate_size(text)
        _write(panel, text, (round(u - size[0] / 2), max(round(v - size[1] / 2), 0)), style.INK, style.HAIRLINE)
    for vehicle in vehicles:
        colour = style.categorical(vehicle.identity)
        if vehicle.trail is not None and len(vehicle.trail) > 1:
            _lines(panel, at(vehicle.trail[-_LONG:])[None], colour, 1)
        if vehicle.result is None or vehicle.pose is None:
            continue
        known = vehicle.result.diagnostics
        for used, shade in ((known.point_weights < TRUSTED, grey), (known.point_weights >= TRUSTED, style.HAIRLINE)):
            _dots(panel, at(known.points[used]), shade)
        half = 0.5 * vehicle.result.box_size[0]
        outline = at(transform(vehicle.pose, outline_corners(vehicle.result.box_size)[:4]))
        _lines(panel, outline[[0, 1, 2, 3, 0]][None], colour, 2)
        nose = np.array([[half, 0.0, 0.0], [half + _NOSE, 0.0, 0.0]])
        _lines(panel, at(transform(vehicle.pose, nose))[None], colour, 2)
    return panel


def _lines(canvas: NDArray[np.uint8], lines: Array, colour: Colour, width: int) -> None:
    """Draw lines (L, P, 2) of pixels; those with a point that is not visible are left out."""
    import cv2

    kept = [line for line in lines if np.isfinite(line).all() and np.abs(line).max() < 3e4]
    sharp = 3  # bits behind the point
    paths: Any = [np.rint(line * 2**sharp).astype(np.int32)[:, None] for line in kept]
    cv2.polylines(canvas, paths, isClosed=False, color=colour, thickness=width, lineType=cv2.LINE_AA, shift=sharp)


def _dots(canvas: NDArray[np.uint8], points: Array, colour: Colour) -> None:
    """Put pixels (N, 2) onto the canvas; those outside are left out."""
    column, row = np.rint(points).astype(np.int64).T
    inside = (column >= 0) & (column < canvas.shape[1]) & (row >= 0) & (row < canvas.shape[0])
    canvas[row[inside], column[inside]] = colour


def _plate_size(text: str) -> tuple[int, int]:
    """Width and height in pixels of the plate of a text."""
    import cv2

    (wide, high), below = cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, _FACE_SIZE, 1)
    return wide + 3, high + below + 1


def _write(canvas: NDArray[np.uint8], text: str, corner: tuple[int, int], paper: Colour, ink: Colour) -> Rectangle:
    """Write a text on a small plate whose upper left corner is given; returns the plate's pixels."""
    import cv2

    (wide, high), (x, y) = _plate_size(text), corner
    x = min(x, max(canvas.shape[1] - wide, 0))
    cv2.rectangle(canvas, (x, y), (x + wide - 1, y + high - 1), paper, -1)
    baseline = cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, _FACE_SIZE, 1)[1]
    at = (x + 1, y + high - 1 - baseline)
    cv2.putText(canvas, text, at, cv2.FONT_HERSHEY_SIMPLEX, _FACE_SIZE, ink, 1, cv2.LINE_AA)
    return x, y, x + wide, y + high
