"""The scene as seen from above: vehicles with heading, uncertainty of their position and path, and the camera's view.

Drawn with matplotlib, for print: its plate names a vehicle and its line the status, not by colours alone.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from fgrecon.core.arrays import Array
from fgrecon.core.geometry import position_covariance, transform
from fgrecon.core.reconstruction import Reconstruction, Status
from fgrecon.core.vehicle_mesh import Colour
from fgrecon.viz import style
from fgrecon.viz.geometry import NOSE, ellipse, level_axes, outline_corners
from fgrecon.viz.marks import draw_points, unit
from fgrecon.viz.subjects import DrawnScene, DrawnVehicle
from fgrecon.viz.tags import Plates

FONT = 6.0
"""Size of a scene picture's type, points."""
_RADIUS = 2.4477  # standard deviations that hold a position with `describe.LEVEL`, in two dimensions
_SIDES = ((1, 0), (-1, 0), (0.8, 0.8), (-0.8, 0.8), (0.8, -0.8), (-0.8, -0.8), (0, 1), (0, -1))
_VISIBLE = 0.9  # millimetres that the middle one of the ellipses is to be long, from its centre
_SCALES = (1.0, 2.0, 5.0, 10.0, 20.0)
_LEAST_NOSE = 1.5  # millimetres of an arrow before the vehicle
_MARGIN = 1.5
_REACH = np.array([(-150.0, -50.0), (150.0, 250.0)])  # lowest and highest coordinates that are shown at all
_CLOUDS = 1.2  # how much farther than to the vehicles it is shown for their ellipses
_BORDER = 0.3  # metres behind the camera

DASHES: Mapping[Status, Any] = {
    Status.CONVERGED: "-",
    Status.WEAK: (0, (8.0, 1.2)),
    Status.AMBIGUOUS: (0, (3.2, 1.2)),
    Status.DEGENERATE: (0, (1.0, 1.0)),
    Status.FAILED: (0, (1.0, 2.4)),
}
"""Line of each status."""
TRUE_DASHES = (0, (5.0, 1.0, 1.0, 1.0))
"""Of what is known to be true."""
START_DASHES = (0, (1.0, 1.2))
"""Of the first estimate."""


def extent_from_above(scene: DrawnScene) -> Array:
    """(2, 2) lowest and highest coordinates, right and ahead, of all that is drawn, metres."""
    level = level_axes(scene.ground)
    axes = level[[0, 2]]
    points, clouds = [np.array([(-1.5, -_BORDER), (1.5, 6.0)])], []
    for vehicle, result, pose in scene.posed:
        points += [part @ axes.T for part in _outline(pose, result)]
        if (start := scene.starts.get(vehicle.identity)) is not None:
            points.append(_outline(start, result)[0] @ axes.T)
        if (covariance := _covariance(result, pose, level)) is not None:
            clouds.append(pose[:3, 3] @ axes.T + ellipse(covariance, _RADIUS))
    reach = np.clip(np.concatenate(points), *_REACH)  # a pose that is none must not make all others dots
    low, high = reach.min(axis=0), reach.max(axis=0) + np.array([0.0, _MARGIN])
    if clouds:  # but a position that is not known at all does not make all others small
        high[1] = np.clip(np.concatenate(clouds)[:, 1].max() + 0.5, high[1], _CLOUDS * high[1])
    aside = np.array([_MARGIN, 0.0])
    return np.stack([low - aside, high + aside])


def ellipse_scale(scene: DrawnScene, metres_per_millimetre: float) -> float:
    """How many times larger the ellipses are drawn, to be visible."""
    covariances = [_covariance(result, pose, np.eye(3)) for _, result, pose in scene.posed]
    longest = [_RADIUS * np.sqrt(np.linalg.eigvalsh(known).max()) for known in covariances if known is not None]
    if not longest:
        return 1.0
    least = _VISIBLE * metres_per_millimetre / max(float(np.median(longest)), 1e-9)
    return next((scale for scale in _SCALES if scale >= least), _SCALES[-1])


def draw_scene_from_above(axes: Any, scene: DrawnScene, extent: Array, scale: float) -> None:
    """Draw it: right is right of the camera, up is ahead, in the ground plane.

    Args:
        axes: Panel with the aspect of the extent.
        scene: What is drawn; starts faintly.
        extent: (2, 2) lowest and highest coordinates, metres.
        scale: How many times larger ellipses are drawn.
    """
    (left, near), (right, far) = extent
    millimetre = (right - left) / (axes.get_position().width * axes.figure.get_size_inches()[0] * 25.4)
    axes.set_xlim(left, right)
    axes.set_ylim(near, far)
    level = level_axes(scene.ground)
    flat = level[[0, 2]]
    _draw_view(axes, scene, flat, far)
    _draw_scale(axes, far)
    for vehicle in scene.vehicles:
        _draw_beside(axes, vehicle, scene.starts.get(vehicle.identity), flat)
    plates = Plates(axes, FONT)
    for vehicle, result, pose in scene.posed:
        outline = _outline(pose, result, max(NOSE, _LEAST_NOSE * millimetre))
        footprint, nose = (part @ flat.T for part in outline)
        _draw_vehicle(axes, style.categorical(vehicle.identity), DASHES[result.status], footprint, nose)
        covariance = _covariance(result, pose, level)
        if covariance is not None:
            ring = pose[:3, 3] @ flat.T + scale * ellipse(covariance, _RADIUS)
            _draw_region(axes, ring, style.categorical(vehicle.identity) if scene.crowded else None)
        plates.keep_free(np.concatenate([footprint, nose]))
    for vehicle, result, pose in scene.posed:
        corners = _outline(pose, result)[0] @ flat.T
        sides = (corners + np.roll(corners, 1, axis=0)) / 2
        plates.put(vehicle.label, np.concatenate([corners, sides]), _SIDES, style.categorical(vehicle.identity))
    for spine in axes.spines.values():
        spine.set_color(unit(style.HAIRLINE))
        spine.set_linewidth(0.6)


def _outline(pose: Array, result: Reconstruction, arrow: float = NOSE) -> tuple[Array, Array]:
    """(4, 3) footprint, and (2, 3) the middle and the tip of the heading's arrow; camera frame."""
    length = float(result.box_size[0])
    nose = np.array([(0.0, 0.0, 0.0), (length / 2 + arrow, 0.0, 0.0)])
    return transform(pose, outline_corners(result.box_size))[:4], transform(pose, nose)


def _covariance(result: Reconstruction, pose: Array, level: Array) -> Array | None:
    """(2, 2) of the position in the ground plane; None where it is not known."""
    if result.uncertainty.pose_covariance is None:
        return None
    flat = level[[0, 2]]
    covariance: Array = flat @ position_covariance(pose, result.uncertainty.pose_covariance) @ flat.T
    return covariance if np.isfinite(covariance).all() else None


def _draw_beside(axes: Any, vehicle: DrawnVehicle, start: Array | None, flat: Array) -> None:
    """Truth, points of other sensors, path, and first estimate of a vehicle."""
    colour = style.categorical(vehicle.identity)
    if vehicle.truth is not None and vehicle.truth.box_size is not None:
        corners = transform(vehicle.truth.camera_T_object, outline_corners(vehicle.truth.box_size))[:4] @ flat.T
        _path(axes, corners, style.TRUTH, 1.0, TRUE_DASHES, closed=True, zorder=4)
    if vehicle.result is not None and len(vehicle.result.diagnostics.points):
        known = vehicle.result.diagnostics
        draw_points(axes, known.points @ flat.T, known.point_weights, colour, zorder=5.5)
    if vehicle.trail is not None and len(vehicle.trail) > 1:
        _path(axes, vehicle.trail @ flat.T, colour, 0.6, "-", zorder=3)
        axes.plot(*(vehicle.trail @ flat.T).T, ".", color=unit(colour), markersize=1.5)
    if vehicle.result is not None and start is not None:
        corners = _outline(start, vehicle.result)[0] @ flat.T
        _path(axes, corners, style.FADED, 0.7, START_DASHES, closed=True, zorder=3)


def _draw_vehicle(axes: Any, colour: Colour, dashes: Any, footprint: Array, nose: Array) -> None:
    """A footprint, filled faintly, and an arrow from its middle beyond its front."""
    axes.fill(*footprint.T, color=unit(colour), alpha=0.22, linewidth=0, zorder=4)
    _path(axes, footprint, colour, 1.1, dashes, closed=True, zorder=5)
    look = {"arrowstyle": "-|>,head_length=0.28,head_width=0.13", "shrinkA": 0, "shrinkB": 0, "linewidth": 0.8}
    axes.annotate("", nose[1], nose[0], arrowprops={**look, "color": unit(colour)}, zorder=6, annotation_clip=True)


def _draw_region(axes: Any, ring: Array, colour: Colour | None) -> None:
    """How far a position is known; with a colour thinly and below the vehicles, where many of them overlap."""
    many = colour is not None
    line = style.INK if colour is None else colour
    axes.fill(*ring.T, color=unit(line), alpha=0.12 if many else 0.25, linewidth=0, zorder=3 if many else 6)
    _path(axes, ring, line, 0.4 if many else 0.7, "-", closed=True, zorder=3 if many else 7)


def _draw_view(axes: Any, scene: DrawnScene, flat: Array, far: float) -> None:
    """The camera, and the part of the ground that its image is of."""
    camera, middle = scene.camera, float(scene.camera.matrix[1, 2])
    rays = camera.rays(camera.undistort(np.array([(-0.5, middle), (scene.size[0] - 0.5, middle)]))) @ flat.T
    ends = rays / np.maximum(np.linalg.norm(rays, axis=1, keepdims=True), 1e-9) * 4.0 * far
    axes.fill(*np.stack([ends[0], (0.0, 0.0), ends[1]]).T, color=unit(style.BACKGROUND), linewidth=0, zorder=0)
    for end in ends:
        _path(axes, np.stack([(0.0, 0.0), end]), style.FADED, 0.6, (0, (4.0, 1.6)), zorder=2)
    axes.plot(0.0, 0.0, "^", color=unit(style.INK), markersize=4, zorder=8, clip_on=False)


def _draw_scale(axes: Any, far: float) -> None:
    """Lines every so many metres, with their numbers."""
    spacing = next((step for step in (1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0) if far / step <= 7.0), 500.0)
    from matplotlib.ticker import MultipleLocator

    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(MultipleLocator(spacing))
    axes.grid(visible=True, color=unit(style.HAIRLINE), linewidth=0.5)
    axes.set_axisbelow(True)
    axes.tick_params(labelsize=FONT, length=1.5, width=0.5, pad=1.2)
    axes.set_xlabel("right of the camera [m]", fontsize=FONT, labelpad=1)
    axes.set_ylabel("ahead [m]", fontsize=FONT, labelpad=1 if far < 100.0 else -1)  # nearer to wide numbers


def _path(
    axes: Any,
    points: Array,
    colour: Colour,
    width: float,
    dashes: Any,
    *,
    closed: bool = False,
    zorder: float,
) -> None:
    drawn = np.concatenate([points, points[:1]]) if closed else points
    axes.plot(*drawn.T, color=unit(colour), linewidth=width, linestyle=dashes, zorder=zorder)
