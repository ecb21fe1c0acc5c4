"""A picture of a whole image: photograph with wireframes, boxes and ground, the scene from above, and the numbers.

Made to be printed 8 cm wide, as a column of a paper is, or enlarged on a slide: type is 6 points there. What tells
vehicles apart are their plates, and what tells statuses apart are the lines: grey print and any colour vision will do.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.arrays import Array
from fgrecon.core.camera import Camera, Ground
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.geometry import transform
from fgrecon.core.reconstruction import Status
from fgrecon.core.vehicle_mesh import Colour
from fgrecon.viz import style
from fgrecon.viz.from_above import DASHES, FONT, TRUE_DASHES, draw_scene_from_above, ellipse_scale, extent_from_above
from fgrecon.viz.geometry import (
    BOX_EDGES,
    as_image,
    box_path,
    ground_lines,
    image_points,
    level_axes,
    outline_corners,
    resolution,
)
from fgrecon.viz.marks import draw_crop, draw_paths, draw_points
from fgrecon.viz.occlusion import DepthImage, depth_image, pieces_of, render_models, runs_of
from fgrecon.viz.picture import new_figure, place_axes
from fgrecon.viz.scene_table import draw_key, draw_table, scene_page
from fgrecon.viz.subjects import DrawnScene, DrawnVehicle
from fgrecon.viz.tags import Plates

_CM = 1 / 2.54  # inches
_WIDTH, _EDGE, _GAP, _HEADING = 8.0 * _CM, 0.04 * _CM, 0.15 * _CM, 0.32 * _CM
_TALLEST, _ABOVE, _AXIS_LEFT, _AXIS_BELOW = 7.0 * _CM, 4.3 * _CM, 0.74 * _CM, 0.68 * _CM
_LOW, _HIGH, _MOST = 3.2 * _CM, 4.4 * _CM, 7.5 * _CM  # of the view from above; with a long table
_LINE, _KEY = 0.3 * _CM, 5  # a line of the table; lines of the key below it
_DPI, _MOST_DPI = 400, 600
_AHEAD = np.array([5.0, 10.0, 20.0, 40.0, 80.0, 160.0])  # metres, of the ground's lines: evenly spaced they were a band
_SMALL, _SMALL_OF_MANY = 6.0, 14.0  # points: less wide vehicles have no wireframe, which would be a blot
_TAGS = ((0.0, 1.0), (0.8, 1.0), (-0.8, 1.0), (1.0, 0.0), (-1.0, 0.0), (0.0, -1.0))
_HIDDEN = 0.38


def scene_picture(
    image: NDArray[np.uint8] | None,
    vehicles: Sequence[DrawnVehicle],
    camera: Camera,
    *,
    ground: Ground | None = None,
    before: bool = False,
    beside: bool = False,
) -> Any:
    """Draw the vehicles of an image, of a still one or of a frame of a video.

    Args:
        image: (H, W, 3) RGB photograph; without one there is a plain canvas.
        vehicles: What it shows. One without a pose that the keypoints determine has its 2D box.
        camera: The camera that observed them.
        ground: The ground plane: its grid and horizon are drawn, and the view from above is along its normal.
        before: Draw the first estimates of the histories too, in a photograph of their own and from above.
        beside: Put the view from above beside the photograph and not below it, as for a slide.

    Returns:
        A `matplotlib.figure.Figure` with an Agg canvas, 8 cm wide, or twice as much; see `fgrecon.viz.save_picture`.

    Raises:
        InvalidInputError: There is no vehicle, two have the same id, or the image is not (H, W, 3) of bytes.
    """
    if not vehicles:
        raise InvalidInputError("vehicles", "none", "Give at least one.")
    if len({vehicle.identity for vehicle in vehicles}) < len(vehicles):
        raise InvalidInputError("vehicles", [v.identity for v in vehicles], "Give each vehicle an id of its own.")
    photograph = None if image is None else as_image(image)
    histories = [(v.identity, v.result.diagnostics.history) for v in vehicles if before and v.result is not None]
    starts = {identity: history[0].camera_T_object for identity, history in histories if history}
    return _compose(
        photograph, DrawnScene(vehicles, camera, resolution(camera, photograph), ground, starts), beside=beside
    )


def _compose(image: NDArray[np.uint8] | None, scene: DrawnScene, *, beside: bool) -> Any:
    """The figure: photographs, the scene from above, table and key."""
    size = scene.size
    high = min((_WIDTH - 2 * _EDGE) * size[1] / size[0], _TALLEST)
    wide = high * size[0] / size[1]
    stages, heading = (("Start", "Result"), _HEADING) if scene.starts else (("",), 0.0)
    photographs = len(stages) * (high + heading)

    extent, page = extent_from_above(scene), scene_page(scene)
    across, ahead = extent[1] - extent[0]
    width = _ABOVE - _AXIS_LEFT
    least = (photographs if beside else (page.lines + _KEY) * _LINE) - _AXIS_BELOW  # else there were empty space
    tall = float(np.clip(width * ahead / across, max(_LOW, min(least, _MOST)), max(_HIGH, min(least, _MOST))))
    extent = _filled(extent, width / tall)
    scale = ellipse_scale(scene, (extent[1, 0] - extent[0, 0]) / (width / _CM * 10))

    height = tall + _AXIS_BELOW
    total = 2 * _EDGE + (max(photographs, height) if beside else photographs + _GAP + height)
    figure = new_figure(2 * _WIDTH + _GAP if beside else _WIDTH, total)
    figure.set_dpi(np.clip(np.ceil(size[0] / wide), _DPI, _MOST_DPI))
    for panel, stage in enumerate(stages, start=1):
        axes = place_axes(figure, (_WIDTH - wide) / 2, total - _EDGE - panel * (heading + high), wide, high)
        _draw_photograph(axes, image, scene, start=stage == "Start")
        if stage:
            axes.set_title(stage, fontsize=FONT + 1, loc="left", pad=2)
    left, bottom = (_WIDTH + _GAP, total - _EDGE - height) if beside else (0.0, 0.0)
    above = place_axes(figure, left + _AXIS_LEFT, bottom + _AXIS_BELOW, width, tall)
    draw_scene_from_above(above, scene, extent, scale)
    aside = place_axes(figure, left + _ABOVE + _GAP, bottom, _WIDTH - _ABOVE - _GAP - _EDGE, height)
    used = draw_table(aside, page, round(height / _LINE) - _KEY, height / _LINE)
    draw_key(aside, scene, height / _LINE - used, height / _LINE, scale)
    return figure


def _filled(extent: Array, aspect: float) -> Array:
    """The extent widened, or made longer ahead, until it has an aspect."""
    (left, near), (right, far) = extent
    missing = (far - near) * aspect - (right - left)
    if missing >= 0:
        return np.array([(left - missing / 2, near), (right + missing / 2, far)])
    return np.array([(left, near), (right, near + (right - left) / aspect)])


def _draw_photograph(axes: Any, image: NDArray[np.uint8] | None, scene: DrawnScene, *, start: bool) -> None:
    """The photograph with what was estimated; with `start` the first estimates instead."""
    width, height = scene.size
    draw_crop(axes, image, scene.camera, (-0.5, -0.5, width - 0.5, height - 0.5))
    axes.set_aspect("auto")  # the panel has the image's
    for spine in axes.spines.values():
        spine.set_linewidth(0.4)
    depth = depth_image([result for _, result, _ in scene.posed], scene.camera, scene.size)
    if scene.ground is not None and not start:
        _draw_ground(axes, scene, scene.ground, depth, style.HAIRLINE if image is None else style.PAPER)
    models = [(v.model, pose, style.categorical(v.identity)) for v, _, pose in scene.posed if v.model is not None]
    if models and not start:
        rendered = render_models(models, scene.camera, scene.size)
        axes.imshow(rendered, extent=(-0.5, width - 0.5, height - 0.5, -0.5), aspect="auto", zorder=1.5)
    points = axes.get_position().width * axes.figure.get_size_inches()[0] * 72 / width  # in a pixel
    small = _SMALL_OF_MANY if scene.crowded else _SMALL
    for vehicle, result, pose in sorted(scene.posed, key=lambda item: -float(item[2][2, 3])):
        colour = style.categorical(vehicle.identity)
        if not start:
            _draw_box(axes, vehicle, transform(pose, outline_corners(result.box_size)), scene.camera, depth)
            if vehicle.model is None and points * float(vehicle.box[2] - vehicle.box[0]) > small:
                lines = pieces_of(transform(pose, result.wireframe)[result.shape.edges])
                visible, hidden = runs_of(lines, scene.camera, depth)
                behind = style.FADED if image is None else style.PAPER
                draw_paths(axes, hidden, behind, 0.35, "-", zorder=2, casing=False, alpha=_HIDDEN)
                draw_paths(axes, visible, colour, 0.9, "-", zorder=4)
            if len(result.diagnostics.points):
                pixels = image_points(scene.camera, np.eye(4), result.diagnostics.points)
                draw_points(axes, pixels, result.diagnostics.point_weights, colour, zorder=3)
        elif vehicle.identity in scene.starts:
            first = result.diagnostics.history[0]
            lines = pieces_of(transform(first.camera_T_object, first.keypoints)[result.shape.edges])
            draw_paths(axes, runs_of(lines, scene.camera, None)[0], colour, 0.8, "-", zorder=4)
    for vehicle in scene.vehicles:
        if vehicle.pose is None:
            outline, colour = box_path(vehicle.box), style.categorical(vehicle.identity)
            draw_paths(axes, [outline], colour, 0.8, DASHES[Status.FAILED], zorder=5)
    _name(axes, scene.vehicles)


def _name(axes: Any, vehicles: Sequence[DrawnVehicle]) -> None:
    """Put plates above the vehicles, the nearest first, which cover no vehicle's middle."""
    plates = Plates(axes, FONT)
    for vehicle in sorted(vehicles, key=lambda v: v.box[3]):
        x1, y1, x2, y2 = vehicle.box
        plates.keep_free(np.array([(x1 + 0.25 * (x2 - x1), y1 + 0.25 * (y2 - y1)), (x2 - 0.25 * (x2 - x1), y2)]))
    for vehicle in sorted(vehicles, key=lambda v: -v.box[3]):
        x1, y1, x2, _ = vehicle.box
        top = np.array([(0.75 * x1 + 0.25 * x2, y1), ((x1 + x2) / 2, y1), (0.25 * x1 + 0.75 * x2, y1)])
        plates.put(vehicle.label, top, _TAGS, style.categorical(vehicle.identity))


def _draw_ground(axes: Any, scene: DrawnScene, ground: Ground, depth: DepthImage, colour: Colour) -> None:
    """The horizon, and a grid on the ground as far as vehicles are."""
    camera, places = scene.camera, [pose[:3, 3] for *_, pose in scene.posed]
    lines = ground_lines(ground, places, lambda far: _AHEAD[max(far, _AHEAD[0]) >= _AHEAD])
    visible, _ = runs_of(pieces_of(lines, 120), camera, depth)
    draw_paths(axes, visible, colour, 0.35, "-", zorder=1, casing=False, alpha=0.65)
    turns, (right, _, ahead) = np.linspace(-1.2, 1.2, 40), level_axes(ground)
    horizon = (np.multiply.outer(np.sin(turns), right) + np.multiply.outer(np.cos(turns), ahead)) * 1e4
    visible, _ = runs_of(horizon[None], camera, depth)
    draw_paths(axes, visible, style.INK, 0.5, (0, (6.0, 2.5, 1.0, 2.5)), zorder=1)


def _draw_box(axes: Any, vehicle: DrawnVehicle, corners: Array, camera: Camera, depth: DepthImage) -> None:
    """The box of a vehicle with corners (8, 3), and the true one; what is hidden of it is faint."""
    assert vehicle.result is not None
    colour = style.categorical(vehicle.identity)
    if vehicle.truth is not None and vehicle.truth.box_size is not None:
        true = transform(vehicle.truth.camera_T_object, outline_corners(vehicle.truth.box_size))[BOX_EDGES]
        visible, hidden = runs_of(pieces_of(true), camera, depth)
        draw_paths(axes, [*visible, *hidden], style.TRUTH, 0.6, TRUE_DASHES, zorder=2)
    visible, hidden = runs_of(pieces_of(corners[BOX_EDGES]), camera, depth)
    draw_paths(axes, hidden, colour, 0.4, (0, (1.0, 1.5)), zorder=2, casing=False, alpha=_HIDDEN)
    draw_paths(axes, visible, colour, 0.55, DASHES[vehicle.result.status], zorder=4)
