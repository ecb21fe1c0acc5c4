"""Scenery of rendered scenes, simulated and seeded: the paint of a car, and a road to stand on."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.arrays import Array
from fgrecon.core.camera import Camera, Ground
from fgrecon.simulation.render import Paint, pixel_rays, sky

Mask = NDArray[np.bool_]
_Cover = Callable[[Mask, Array, float], None]

BODY_COLOURS = {
    "red": (0.42, 0.015, 0.02),
    "blue": (0.02, 0.08, 0.33),
    "silver": (0.42, 0.44, 0.46),
    "green": (0.03, 0.16, 0.08),
    "white": (0.72, 0.72, 0.70),
    "orange": (0.60, 0.16, 0.01),
}
"""Linear RGB of car bodies."""

_HAZE = np.array([0.26, 0.33, 0.33])
_GLASS, _TYRE, _RIM, _TRIM = (np.array(c) for c in ([0.012, 0.016, 0.02], [0.012] * 3, [0.38, 0.39, 0.40], [0.02] * 3))
_HEADLIGHT, _TAILLIGHT, _PLATE = (np.array(c) for c in ([0.80, 0.84, 0.9], [0.75, 0.01, 0.008], [0.75, 0.75, 0.70]))


def car_paint(keypoints: Array, names: tuple[str, ...], colour: tuple[float, float, float]) -> Paint:
    """Paint of a car with windows, wheels and lamps where its keypoints say that they are.

    Args:
        keypoints: (K, 3) object frame, metres.
        names: Their names; those of `car14` are used, and what belongs to a missing name is left in the body's colour.
        colour: Linear RGB of the body.
    """
    at = {name: keypoints[i] for i, name in enumerate(names)}

    def paint(points: Array, normals: Array) -> tuple[Array, Array]:
        albedo = np.tile(np.asarray(colour, dtype=np.float64), (len(points), 1))
        gloss = np.ones(len(points))

        def cover(where: Mask, with_colour: Array, with_gloss: float) -> None:
            albedo[where] = with_colour
            gloss[where] = with_gloss

        if {"left_front_roof", "left_back_roof", "left_side_mirror"} <= at.keys():
            cover(_windows(points, normals, at), _GLASS, 1.0)
        _trim(points, normals, at, cover)
        for name, place in at.items():
            if name.endswith("wheel"):
                _wheel(points, place, cover)
            elif name.endswith("headlight"):
                _lamp(points, place, normals[:, 0] > 0.1, _HEADLIGHT, cover)
            elif name.endswith("taillight"):
                _lamp(points, place, normals[:, 0] < 0.3, _TAILLIGHT, cover)
        return albedo, gloss

    return paint


def planter(length: float, width: float, height: float, seed: int) -> tuple[Array, NDArray[np.int32], Paint]:
    """A concrete trough with a hedge: vertices (48, 3), faces (24, 3) and paint. Metres, origin on the ground."""
    trough, hedge = 0.45 * height, height
    vertices = [_box(length, width, -trough, 0.0), _box(0.94 * length, 0.86 * width, -hedge, -trough)]
    faces = np.concatenate([_BOX_FACES, _BOX_FACES + 24])
    rng = np.random.default_rng(seed)
    table = int(rng.integers(2**31))

    def paint(points: Array, normals: Array) -> tuple[Array, Array]:
        grains = np.random.default_rng(table)
        u, v = (points @ np.array([[1.0, 0.4], [0.3, 1.0], [-0.5, 0.9]])).T  # no side of the box is seen edge-on
        leaves = _grain(u * 1.7, v * 1.7, grains) + _grain(u * 4.1, v * 4.1, grains)
        concrete = np.array([0.30, 0.29, 0.27]) * (1.0 + 0.10 * leaves)[:, None]
        green = np.array([0.035, 0.085, 0.020]) * (1.0 + 0.5 * leaves)[:, None]
        albedo = np.where((points[:, 1] < -trough)[:, None], green, concrete)
        return albedo, np.zeros(len(normals))

    return np.concatenate(vertices), faces, paint


def road(camera: Camera, ground: Ground, image_size: tuple[int, int], seed: int) -> Array:
    """A straight road under a cloudy sky, with hills and trees at the horizon, as the camera sees it.

    Args:
        camera: Pinhole camera; lens distortion is not drawn.
        ground: The road's plane; the road runs along the camera's forward axis.
        image_size: Width and height in pixels.
        seed: Of clouds, hills, trees and the asphalt's grain.

    Returns:
        (H, W, 3) linear RGB.
    """
    rng = np.random.default_rng(seed)
    rays = pixel_rays(camera.matrix, image_size)
    lateral, forward = _ground_axes(ground)
    down = rays @ ground.normal
    below = down > 1e-3
    pixel = 1.0 / camera.matrix[0, 0]  # radians
    colours = np.empty_like(rays)
    above = rays[~below]
    colours[~below] = _open_sky(above @ lateral, above @ forward, -down[~below], pixel, rng)
    reach = ground.distance / down[below]
    points = rays[below] * reach[:, None]
    surface = _road_surface(points @ lateral, points @ forward, reach * pixel, rng)
    haze = 1.0 - np.exp(-reach / 150.0)
    colours[below] = surface + (_HAZE - surface) * haze[:, None]
    return colours


def with_shadow(background: Array, camera: Camera, camera_T_object: Array, length: float, width: float) -> Array:
    """Darken the ground y = 0 of the object frame below a vehicle of the given length and width in metres.

    Args:
        background: (H, W, 3) linear RGB.
        camera: Pinhole camera.
        camera_T_object: (4, 4) pose.
        length: Along the object's x axis.
        width: Along its z axis.
    """
    rays = pixel_rays(camera.matrix, (background.shape[1], background.shape[0]))
    rotation, translation = camera_T_object[:3, :3], camera_T_object[:3, 3]
    local = rays @ rotation
    centre = -rotation.T @ translation
    reach = -centre[1] / np.maximum(local[..., 1], 1e-6)  # far away where the ray does not meet the ground
    x, z = (centre[i] + reach * local[..., i] for i in (0, 2))
    # distance to a rectangle with rounded corners, negative inside
    dx, dz = np.abs(x) - 0.5 * length + 0.3, np.abs(z) - 0.5 * width + 0.3
    distance = np.hypot(np.maximum(dx, 0.0), np.maximum(dz, 0.0)) + np.minimum(np.maximum(dx, dz), 0.0) - 0.3
    t = np.clip((0.30 - distance) / 0.55, 0.0, 1.0)
    return background * (1.0 - 0.85 * (t * t * (3.0 - 2.0 * t)))[..., None]


def _box(length: float, width: float, top: float, bottom: float) -> Array:
    """(24, 3) corners of a box about the y axis, each once per side that it belongs to, so that edges are sharp."""
    x, z = 0.5 * length, 0.5 * width
    corners = np.array([[i, j, k] for i in (-x, x) for j in (top, bottom) for k in (-z, z)])
    return corners[np.array([0, 1, 3, 2, 4, 6, 7, 5, 0, 4, 5, 1, 2, 3, 7, 6, 0, 2, 6, 4, 1, 5, 7, 3])]


_BOX_FACES = np.array([[4 * side + i for i in t] for side in range(6) for t in ((0, 1, 2), (0, 2, 3))], dtype=np.int32)


def _windows(points: Array, normals: Array, at: Mapping[str, Array]) -> Mask:
    """Glass: between belt line and roof, away from the pillars."""
    x, height, side = points[:, 0], -points[:, 1], np.abs(points[:, 2])
    roof_front, roof_back, mirror = (at[f"left_{n}"] for n in ("front_roof", "back_roof", "side_mirror"))
    belt = -mirror[1] - 0.10
    top = -0.5 * (roof_front[1] + roof_back[1]) - 0.07
    rise = np.clip((height - belt) / max(top - belt, 0.1), 0.0, 1.0)
    front = mirror[0] + 0.15 + (roof_front[0] - 0.1 - mirror[0] - 0.15) * rise  # the windscreen pillar's line
    back = roof_back[0] - 0.25 + 0.45 * rise
    middle = 0.5 * (mirror[0] + roof_back[0]) - 0.05
    band = (height > belt) & (height < top)
    lateral = np.abs(normals[:, 2]) > 0.62
    beside = lateral & band & (x < front - 0.05) & (x > back) & (np.abs(x - middle) > 0.05)
    beside &= side < mirror[2] - 0.08  # not the mirror's housing
    half = mirror[2] - 0.16 - (mirror[2] - 0.10 - roof_front[2]) * rise
    ahead = ~lateral & (normals[:, 0] > 0.25) & (height > belt + 0.02) & (height < top + 0.03) & (side < half)
    behind = ~lateral & (normals[:, 0] < -0.3) & (height > belt + 0.08) & (height < top + 0.03) & (side < half - 0.04)
    return np.asarray(beside | ahead | behind)


def _trim(points: Array, normals: Array, at: Mapping[str, Array], cover: _Cover) -> None:
    """Grille and number plates between the lamps, and a dark sill all around."""
    x, height, side = points[:, 0], -points[:, 1], np.abs(points[:, 2])
    cover(height < 0.24, _TRIM, 0.1)
    if {"left_headlight", "left_taillight"} <= at.keys():
        front, back = at["left_headlight"], at["left_taillight"]
        ahead, behind = (normals[:, 0] > 0.5) & (x > 0.8 * front[0]), (normals[:, 0] < -0.5) & (x < 0.8 * back[0])
        cover(ahead & (np.abs(height + front[1] + 0.36) < 0.10) & (side < 0.8 * front[2]), _TRIM, 0.2)
        cover(ahead & (np.abs(height + front[1] + 0.22) < 0.055) & (side < 0.26), _PLATE, 0.2)
        cover(behind & (np.abs(height + back[1] + 0.30) < 0.055) & (side < 0.26), _PLATE, 0.2)


def _wheel(points: Array, centre: Array, cover: _Cover) -> None:
    """Tyre, rim and five spokes about a wheel's centre, whose height is the wheel's radius."""
    x, y = (points[:, i] - centre[i] for i in range(2))
    beside = points[:, 2] * centre[2] > 0.35 * centre[2] ** 2
    radius = np.hypot(x, y) / -centre[1]
    cover(beside & (radius < 1.10), _TRIM, 0.0)
    cover(beside & (radius < 0.97), _TYRE, 0.05)
    cover(beside & (radius < 0.66), _RIM, 0.6)
    gap = np.abs((np.arctan2(y, x) * 5.0 / (2.0 * np.pi)) % 1.0 - 0.5)
    cover(beside & (radius > 0.18) & (radius < 0.56) & (gap < 0.30), _TYRE, 0.05)


def _lamp(points: Array, centre: Array, facing: Mask, colour: Array, cover: _Cover) -> None:
    """A lamp with a darker rim."""
    size = (((points - centre) / np.array([0.20, 0.09, 0.19])) ** 2).sum(axis=1)
    cover(facing & (size < 1.0), 0.25 * colour, 1.0)
    cover(facing & (size < 0.72), colour, 1.0)


def _ground_axes(ground: Ground) -> tuple[Array, Array]:
    """Unit vectors in the plane: to the right, and forward along the camera's axis."""
    lateral = np.cross(ground.normal, np.array([0.0, 0.0, 1.0]))
    lateral /= np.linalg.norm(lateral)
    return lateral, np.cross(lateral, ground.normal)


def _open_sky(right: Array, ahead: Array, up: Array, pixel: float, rng: np.random.Generator) -> Array:
    """Linear RGB (M, 3) of sky, clouds, hills and trees in unit directions given by their components.

    `pixel` is the angle that a pixel spans, in radians: outlines are that soft.
    """
    colours = sky(np.stack([right, -np.maximum(up, 0.0), ahead], axis=-1))
    reach = 1.0 / np.maximum(up, 0.02)  # clouds lie in a plane
    density = sum(_grain(right * reach * f, ahead * reach * f, rng) / f for f in (0.05, 0.11, 0.23)) * 0.05
    cover = np.clip(1.6 * density - 0.1, 0.0, 1.0) * np.clip(up * 8.0, 0.0, 1.0)
    colours += (np.array([0.95, 0.96, 0.97]) - colours) * cover[:, None]
    azimuth = np.arctan2(right, ahead)
    for height, colour in ((0.050, (0.24, 0.34, 0.38)), (0.026, (0.045, 0.095, 0.045))):
        outline = np.full_like(azimuth, height)
        for frequency in (7.0, 19.0, 47.0, 113.0, 271.0):
            outline += 0.4 * height * (7.0 / frequency) ** 0.6 * np.sin(frequency * azimuth + rng.uniform(0.0, 6.3))
        foot = 0.5 + 0.5 * np.clip(up / np.maximum(outline, 1e-3), 0.0, 1.0)
        hidden = np.clip((outline - up) / pixel + 0.5, 0.0, 1.0)
        colours += (_HAZE + (np.array(colour) - _HAZE) * foot[:, None] - colours) * hidden[:, None]
    return colours


def _road_surface(across: Array, along: Array, footprint: Array, rng: np.random.Generator) -> Array:
    """Linear RGB (M, 3) of asphalt with lane markings, pavement and grass, in metres to the right and ahead.

    `footprint` (M,) is the width in metres that a pixel spans there: edges are that soft.
    """
    grain = _grain(across, along, rng) / (1.0 + 60.0 * footprint)
    edge = np.abs(across - 0.5)

    def within(distance: Array, half: float) -> Array:
        """Share of a pixel that lies nearer than `half`."""
        return np.clip((half - distance) / footprint + 0.5, 0.0, 1.0)[:, None]

    colour = np.array([0.10, 0.16, 0.04]) * (1.0 + 0.7 * grain)[:, None]
    for half, shade, roughness in ((7.4, [0.25, 0.24, 0.22], 0.2), (5.6, [0.085, 0.085, 0.088], 0.35)):
        colour += (np.array(shade) * (1.0 + roughness * grain)[:, None] - colour) * within(edge, half)
    dashes = within(edge, 0.07) * within(np.abs(along % 9.0 - 4.5), 2.0)
    lines = within(np.abs(edge - 5.2), 0.07)
    colour += (0.62 - colour) * np.maximum(dashes, lines)
    return colour


def _grain(x: Array, y: Array, rng: np.random.Generator) -> Array:
    """Noise in [-1, 1] that is smooth over cells of 0.12 m."""
    table = rng.uniform(-1.0, 1.0, (256, 256))
    u, v = x / 0.12, y / 0.12
    i, j = np.floor(u).astype(np.int64), np.floor(v).astype(np.int64)
    a, b = u - i, v - j
    a, b = a * a * (3.0 - 2.0 * a), b * b * (3.0 - 2.0 * b)
    corner = [[table[(i + p) % 256, (j + q) % 256] for q in (0, 1)] for p in (0, 1)]
    low = corner[0][0] * (1.0 - b) + corner[0][1] * b
    high = corner[1][0] * (1.0 - b) + corner[1][1] * b
    return np.asarray(low * (1.0 - a) + high * a)
