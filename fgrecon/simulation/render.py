"""A small software renderer: draws a shape's surface over a background into an RGB image, with depth and mask.

Numpy alone, and deterministic. A z-buffer finds which triangle each (sub)pixel shows; shading then works per pixel with
interpolated normals: a sun, a sky that is bright above and dark ground below, and the reflection of both in what is
glossy. Colours are linear RGB until the very end. See `fgrecon.simulation.scenery` for what a car is painted with and
the road below it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.arrays import Array
from fgrecon.core.camera import Camera
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.geometry import transform
from fgrecon.core.repr import brief_repr

Paint = Callable[[Array, Array], tuple[Array, Array]]
"""Maps points (M, 3) and unit normals (M, 3) of the object frame to albedo (M, 3) and gloss (M,), all in [0, 1]."""

_NEAREST = 0.05
"""Triangles that reach nearer to the camera than this, in metres, are left out."""

_SUN = np.array([-0.35, -0.8, -0.5]) / np.linalg.norm([-0.35, -0.8, -0.5])  # towards it, camera frame
_SUNLIGHT = np.array([1.00, 0.93, 0.82])
_ZENITH, _HORIZON, _EARTH = (np.array(c) for c in ([0.10, 0.26, 0.62], [0.70, 0.80, 0.90], [0.07, 0.07, 0.065]))
_GAMMA = 2.2


@dataclass(frozen=True)
class Body:
    """One thing to draw."""

    vertices: Array  # (V, 3) surface, object frame, metres
    # (F, 3) its triangles, counter-clockwise as seen from outside. Normals are interpolated between triangles
    # that share a vertex: a sharp edge needs vertices of its own on either side
    faces: NDArray[np.integer]
    paint: Paint  # its colours
    camera_T_object: Array  # (4, 4) pose


@dataclass(frozen=True)
class Picture:
    """A rendered image."""

    image: NDArray[np.uint8]  # (H, W, 3) RGB
    depth: Array  # (H, W) distance along the camera's z axis in metres, infinite where nothing was drawn
    body: NDArray[np.int16]  # (H, W) index of the body that is seen at the pixel's centre, -1 where none is

    __repr__ = brief_repr


@dataclass(frozen=True)
class Fragments:
    """The M pixels that show a surface."""

    rows: NDArray[np.intp]  # (M,) row of each
    columns: NDArray[np.intp]  # (M,) column of each
    face: NDArray[np.intp]  # (M,) triangle that it shows
    weights: Array  # (M, 3) of the triangle's corners at the point seen, summing to 1
    depth: Array  # (M,) along the camera's z axis, metres

    def interpolate(self, values: Array, faces: NDArray[np.integer]) -> Array:
        """(M, C) values at the fragments from values (V, C) at the vertices."""
        return np.einsum("mi,mic->mc", self.weights, values[faces[self.face]])


def rasterise(vertices: Array, faces: NDArray[np.integer], matrix: Array, image_size: tuple[int, int]) -> Fragments:
    """Find the nearest triangle at the centre of every pixel.

    Args:
        vertices: (V, 3) camera frame, metres.
        faces: (F, 3) triangles, seen from either side.
        matrix: (3, 3) intrinsics.
        image_size: Width and height in pixels.
    """
    width, height = image_size
    inverse = 1.0 / np.maximum(vertices[:, 2], _NEAREST)
    homogeneous = vertices @ matrix.T
    corners = (homogeneous[:, :2] * inverse[:, None])[faces]
    first = np.maximum(np.ceil(corners.min(axis=1)), 0.0).astype(np.intp)
    last = np.minimum(np.floor(corners.max(axis=1)), [width - 1.0, height - 1.0]).astype(np.intp)
    planes, proper = _planes(corners, inverse[faces])
    drawn = proper & (first <= last).all(axis=1) & (vertices[:, 2] > _NEAREST)[faces].all(axis=1)
    nearest = np.zeros((height, width))  # largest 1 / z so far
    shown = np.full((height, width), -1, dtype=np.intp)
    for f in np.flatnonzero(drawn):
        (left, top), (right, bottom) = first[f], last[f] + 1
        u, v = np.arange(left, right), np.arange(top, bottom)[:, None]
        beta, gamma, inverse_z = (p[0] * u + p[1] * v + p[2] for p in planes[f])
        window = nearest[top:bottom, left:right]
        inside = (beta >= 0) & (gamma >= 0) & (beta + gamma <= 1) & (inverse_z > window)
        window[inside] = inverse_z[inside]
        shown[top:bottom, left:right][inside] = f
    rows, columns = np.nonzero(shown >= 0)
    face = shown[rows, columns]
    p = planes[face]
    beta, gamma, inverse_z = (p[:, i, 0] * columns + p[:, i, 1] * rows + p[:, i, 2] for i in range(3))
    image_weights = np.stack([1.0 - beta - gamma, beta, gamma], axis=1)
    weights = image_weights * inverse[faces[face]] / inverse_z[:, None]  # perspective: 1 / z is what is linear
    return Fragments(rows, columns, face, weights, 1.0 / inverse_z)


def render(bodies: Sequence[Body], camera: Camera, background: Array, supersampling: int = 3) -> Picture:
    """Draw bodies over a background, the nearer in front.

    Args:
        bodies: At least one.
        camera: Pinhole camera; lens distortion is not drawn.
        background: (H, W, 3) linear RGB.
        supersampling: Subpixels per pixel and axis, for smooth outlines; odd, so that one is the pixel's centre.

    Raises:
        InvalidInputError: `supersampling` is not odd and positive.
    """
    if supersampling < 1 or supersampling % 2 == 0:
        raise InvalidInputError("supersampling", supersampling, "Give an odd number from 1.")
    height, width = background.shape[:2]
    picture = Picture(
        to_rgb(background), np.full((height, width), np.inf), np.full((height, width), -1, dtype=np.int16)
    )
    in_camera = [transform(b.camera_T_object, b.vertices) for b in bodies]
    vertices = np.concatenate(in_camera)
    first_vertex = np.cumsum([0] + [len(b.vertices) for b in bodies])
    faces = np.concatenate([b.faces + start for b, start in zip(bodies, first_vertex, strict=False)])
    window = _window(camera.project(vertices[vertices[:, 2] > _NEAREST]), width, height)
    if window is None:
        return picture
    left, top, right, bottom = window
    patch = (slice(top, bottom), slice(left, right))
    matrix = camera.matrix - np.array([[0.0, 0.0, left], [0.0, 0.0, top], [0.0, 0.0, 0.0]])
    fine = _supersampled(matrix, supersampling)
    fragments = rasterise(vertices, faces, fine, ((right - left) * supersampling, (bottom - top) * supersampling))
    owner = np.repeat(np.arange(len(bodies)), [len(b.faces) for b in bodies])[fragments.face]
    colours = background[patch].repeat(supersampling, axis=0).repeat(supersampling, axis=1)
    colours[fragments.rows, fragments.columns] = _colours(bodies, vertices, faces, fragments, owner)
    depth = np.full(colours.shape[:2], np.inf)
    depth[fragments.rows, fragments.columns] = fragments.depth
    body = np.full(colours.shape[:2], -1, dtype=np.int16)
    body[fragments.rows, fragments.columns] = owner
    cells = (bottom - top, supersampling, right - left, supersampling, 3)
    centre = slice(supersampling // 2, None, supersampling)
    picture.image[patch] = to_rgb(colours.reshape(cells).mean(axis=(1, 3)))
    picture.depth[patch] = depth[centre, centre]
    picture.body[patch] = body[centre, centre]
    return picture


def _colours(
    bodies: Sequence[Body], vertices: Array, faces: NDArray[np.integer], fragments: Fragments, owner: NDArray[np.intp]
) -> Array:
    """Linear RGB (M, 3) of every fragment; `vertices` (V, 3) and `faces` (F, 3) are those of all bodies."""
    points = fragments.interpolate(vertices, faces)
    normals = fragments.interpolate(_vertex_normals(vertices, faces), faces)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    albedo, gloss = np.empty_like(points), np.empty(len(points))
    for index, body in enumerate(bodies):
        mine = owner == index
        rotation, translation = body.camera_T_object[:3, :3], body.camera_T_object[:3, 3]
        albedo[mine], gloss[mine] = body.paint((points[mine] - translation) @ rotation, normals[mine] @ rotation)
    return _shade(albedo, gloss, normals, points)


def _window(pixels: Array, width: int, height: int) -> tuple[int, int, int, int] | None:
    """First and one-past-last column and row (left, top, right, bottom) that pixels (M, 2) span in the image."""
    if not len(pixels):
        return None
    left, top = np.maximum(np.floor(pixels.min(axis=0)), 0.0).astype(int)
    right, bottom = np.minimum(np.ceil(pixels.max(axis=0)) + 1.0, [width, height]).astype(int)
    return (int(left), int(top), int(right), int(bottom)) if left < right and top < bottom else None


def _supersampled(matrix: Array, factor: int) -> Array:
    """Intrinsics (3, 3) of the same camera with `factor` subpixels per pixel and axis."""
    # Pixel centres are at integers: the image spans [-0.5, W - 0.5] before and [-0.5, S W - 0.5] after.
    shift = np.array([[0.0, 0.0, 0.5 * (factor - 1.0)], [0.0, 0.0, 0.5 * (factor - 1.0)], [0.0, 0.0, 0.0]])
    return matrix * np.array([[factor], [factor], [1.0]]) + shift


def pixel_rays(matrix: Array, image_size: tuple[int, int]) -> Array:
    """Unit viewing directions (H, W, 3) of every pixel, camera frame."""
    width, height = image_size
    u, v = np.meshgrid(np.arange(width), np.arange(height))
    rays = np.stack([u, v, np.ones_like(u)], axis=-1) @ np.linalg.inv(matrix).T
    return rays / np.linalg.norm(rays, axis=-1, keepdims=True)


def sky(directions: Array) -> Array:
    """Linear RGB (..., 3) of the sky, or of the earth below the horizon, in unit directions (..., 3)."""
    up = -directions[..., 1:2]
    above = _HORIZON + (_ZENITH - _HORIZON) * np.clip(up, 0.0, 1.0) ** 0.5
    below = np.clip(-up * 12.0, 0.0, 1.0)
    return above + (_EARTH - above) * below


def to_rgb(linear: Array) -> NDArray[np.uint8]:
    """8-bit RGB of linear colours, rolled off softly towards white."""
    exposed = 1.0 - np.exp(-1.6 * np.maximum(linear, 0.0))
    return np.round(255.0 * exposed ** (1.0 / _GAMMA)).astype(np.uint8)


def _planes(corners: Array, corner_values: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Coefficients (F, 3, 3) of beta, gamma and an interpolated value as p0 u + p1 v + p2 in the image.

    Also which triangles span an area (F,).
    """
    a = corners[:, 0]
    (ub, vb), (uc, vc) = (corners[:, 1] - a).T, (corners[:, 2] - a).T
    area = ub * vc - uc * vb
    proper = np.abs(area) > 1e-12
    scale = 1.0 / np.where(proper, area, 1.0)
    beta = np.stack([vc * scale, -uc * scale], axis=1)
    gamma = np.stack([-vb * scale, ub * scale], axis=1)
    steps = corner_values[:, 1:] - corner_values[:, :1]
    value = beta * steps[:, :1] + gamma * steps[:, 1:]
    gradients = np.stack([beta, gamma, value], axis=1)
    offsets = -np.einsum("fij,fj->fi", gradients, a)
    offsets[:, 2] += corner_values[:, 0]
    return np.concatenate([gradients, offsets[:, :, None]], axis=2), proper


def _vertex_normals(vertices: Array, faces: NDArray[np.integer]) -> Array:
    """(V, 3) outward normals, each the sum of its triangles' weighted by area; not of unit length."""
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    normals = np.zeros_like(vertices)
    across = np.cross(b - a, c - a)
    for i in range(3):
        np.add.at(normals, faces[:, i], across)
    return normals


def _shade(albedo: Array, gloss: Array, normals: Array, points: Array) -> Array:
    """Linear RGB (M, 3) of points (M, 3) seen from the origin, camera frame."""
    viewing = points / np.linalg.norm(points, axis=1, keepdims=True)
    facing = np.clip(-(normals * viewing).sum(axis=1), 0.0, 1.0)
    mirrored = viewing + 2.0 * facing[:, None] * normals
    sun = np.clip(normals @ _SUN, 0.0, 1.0)[:, None] * _SUNLIGHT
    skylight = (0.5 - 0.5 * normals[:, 1:2]) * 0.55 + 0.05
    fresnel = (0.06 + 0.94 * (1.0 - facing) ** 5) * gloss
    spot = np.clip(mirrored @ _SUN, 0.0, 1.0) ** 120 * gloss
    colour: Array = (
        albedo * (0.75 * sun + skylight) + fresnel[:, None] * sky(mirrored) + 0.8 * spot[:, None] * _SUNLIGHT
    )
    return colour
