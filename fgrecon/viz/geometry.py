"""Geometry that recordings and pictures share: projections, boxes, crops, ellipsoids, planes and ground grids."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fgrecon.core.arrays import Array
from fgrecon.core.box3d import box_corners
from fgrecon.core.camera import Camera, Ground
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.geometry import cross, transform
from fgrecon.core.observation import Observation

Box = tuple[float, float, float, float]
"""x1, y1, x2, y2 in pixels."""

BOX_EDGES = np.array(
    [(0, 1), (1, 2), (2, 3), (3, 0), (4, 5), (5, 6), (6, 7), (7, 4), (0, 4), (1, 5), (2, 6), (3, 7)], dtype=np.int64
)
"""(12, 2) edges of the corners that `outline_corners` gives; the first four bound the bottom face."""

NOSE = 1.6
"""Metres that an arrow along the heading goes beyond a vehicle's front."""

_AROUND = [5, 4, 0, 1, 7, 6, 2, 3]  # of the corners that `fgrecon.core.box3d.box_corners` gives
_NEAR = 0.1  # metres before the camera from which points are drawn
_FAR_PIXEL = 1e5
_MARGIN = 0.18  # of a crop on each side, relative to what it shows
_HALF_GRID = 6.0  # metres, of the grid around a vehicle
_GRID_SPACING, _GRID_NEAREST = 5.0, 0.5  # metres: of the ground's grid, and where it begins
_GRID_ASIDE, _GRID_BEYOND = 15.0, 10.0  # metres: to each side at least, and beyond the farthest vehicle


def as_image(image: ArrayLike) -> NDArray[np.uint8]:
    """The photograph as (H, W, 3) RGB bytes.

    Raises:
        InvalidInputError: It is anything else.
    """
    array = np.asarray(image)
    if array.ndim != 3 or array.shape[2] != 3 or array.dtype != np.uint8 or not array.size:
        raise InvalidInputError("image", f"{array.dtype} {array.shape}", "Give RGB bytes in an array (H, W, 3).")
    return array


def resolution(camera: Camera, image: NDArray[np.uint8] | None) -> tuple[float, float]:
    """(width, height) of the image plane in pixels: the image's, else the camera's, else twice the principal point."""
    if image is not None:
        return float(image.shape[1]), float(image.shape[0])
    if camera.image_size is not None:
        return float(camera.image_size[0]), float(camera.image_size[1])
    return max(2 * float(camera.matrix[0, 2]), 1.0), max(2 * float(camera.matrix[1, 2]), 1.0)


def image_points(camera: Camera, camera_T_object: Array, points: Array) -> Array:
    """(M, 2) pixels of object points (M, 3) in the real image, lens distortion included.

    Rows are NaN where a point is behind the camera or too far outside of the image to be drawn.
    """
    in_camera = transform(camera_T_object, points)
    with np.errstate(invalid="ignore"):
        visible = in_camera[:, 2] > _NEAR
    pixels = np.full((len(points), 2), np.nan)
    if visible.any():
        pixels[visible] = camera.distort(camera.project(in_camera[visible]))
        with np.errstate(invalid="ignore"):
            pixels[~(np.abs(pixels) < _FAR_PIXEL).all(axis=1)] = np.nan
    return pixels


def outline_corners(size: Array) -> Array:
    """(8, 3) corners of a vehicle's box of length, width, height in the object frame: bottom face first, metres.

    In each face the order is front left, front right, rear right, rear left.
    """
    return box_corners(size)[_AROUND]


def box_path(box: Array) -> Array:
    """(5, 2) closed outline of a 2D box x1, y1, x2, y2."""
    x1, y1, x2, y2 = box
    return np.array([(x1, y1), (x2, y1), (x2, y2), (x1, y2), (x1, y1)])


def crop_around(
    observation: Observation,
    projections: Array,
    *,
    aspect: float,
) -> Box:
    """The part of the image to show: around the box, the measured keypoints and the projected wireframe.

    Args:
        observation: Gives the 2D box and the keypoints.
        projections: (M, 2) projected points that should be shown too; NaN rows do not count. Those far from what was
            observed are left out, so that a bad estimate does not shrink the vehicle to a dot.
        aspect: Width divided by height of the crop.

    Returns:
        x1, y1, x2, y2 in pixels; it may reach beyond the image.
    """
    observed = observation.keypoints[observation.measured]
    if observation.box is not None:
        observed = np.concatenate([observed, observation.box.reshape(2, 2)])
    drawn = projections[np.isfinite(projections).all(axis=1)]
    if len(observed):
        low, high = observed.min(axis=0), observed.max(axis=0)
        reach = 0.6 * (high - low).max()
        drawn = drawn[((drawn > low - reach) & (drawn < high + reach)).all(axis=1)]
    content = np.concatenate([observed, drawn])
    if not len(content):
        content = np.zeros((1, 2))
    low, high = content.min(axis=0), content.max(axis=0)
    centre = (low + high) / 2
    width, height = np.maximum(high - low, 8.0) * (1 + 2 * _MARGIN)
    width, height = max(width, height * aspect), max(height, width / aspect)
    return (centre[0] - width / 2, centre[1] - height / 2, centre[0] + width / 2, centre[1] + height / 2)


def ellipsoids(covariances: Array) -> tuple[Array, Array]:
    """One-sigma ellipsoids of covariances (M, 3, 3): half axes (M, 3), and rotations (M, 3, 3) with them as columns."""
    values, vectors = np.linalg.eigh(covariances)
    vectors[:, :, 2] *= np.sign(np.linalg.det(vectors))[:, None]  # a rotation, not a reflection
    return np.sqrt(np.maximum(values, 0.0)), vectors


def ground_grid(camera_T_object: Array, ground: Ground | None) -> Array:
    """(L, 2, 3) lines of a grid on the ground around a vehicle, in the camera frame, metres.

    The grid is in the ground plane where one is given, else in the plane below the vehicle (y = 0 of its frame).
    """
    origin, down, forward = camera_T_object[:3, 3], camera_T_object[:3, 1], camera_T_object[:3, 0]
    if ground is not None:
        down = ground.normal
        origin = origin + (ground.distance - down @ origin) * down
    forward = forward - (forward @ down) * down
    forward = forward / np.linalg.norm(forward)
    left = cross(forward, down)
    at = np.arange(-_HALF_GRID, _HALF_GRID + 0.5, 1.0)
    low, high = np.full_like(at, -_HALF_GRID), np.full_like(at, _HALF_GRID)
    along = np.stack([np.stack([low, at], axis=-1), np.stack([high, at], axis=-1)], axis=1)
    lines = np.concatenate([along, along[..., ::-1]])
    return origin + lines[..., :1] * forward + lines[..., 1:] * left


def vertex_normals(vertices: Array, faces: NDArray[np.int64]) -> Array:
    """(V, 3) unit normals of a mesh, averaged over the faces at each vertex by area; zero where none meet."""
    a, b, c = vertices.T[:, faces.T].swapaxes(0, 1)
    (x, y, z), (u, v, w) = b - a, c - a
    face_normals = (y * w - z * v, z * u - x * w, x * v - y * u)
    at = faces.ravel()
    normals = np.stack([np.bincount(at, np.repeat(axis, 3), minlength=len(vertices)) for axis in face_normals], axis=1)
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    return normals / np.where(lengths > 0, lengths, 1.0)


def ground_lines(ground: Ground, locations: Sequence[Array], across: Callable[[float], Array]) -> Array:
    """(L, 2, 3) lines of a grid on the ground before the camera, beyond vehicles, in the camera frame, metres.

    Args:
        ground: The ground plane.
        locations: (3,) of each vehicle.
        across: Gives the distances ahead of lines across, of which the last ends the grid, for how far it is to reach.
    """
    right, down, forward = level_axes(ground)
    places = [location @ np.stack([right, forward]).T for location in locations]
    aside = np.ceil(max([_GRID_ASIDE, *(abs(float(place[0])) for place in places)]) / _GRID_SPACING)
    sideways = _GRID_SPACING * np.arange(-aside, aside + 1)
    ahead = across(max((float(place[1]) for place in places), default=_GRID_BEYOND) + _GRID_BEYOND)
    along = np.array([[(x, _GRID_NEAREST), (x, ahead[-1])] for x in sideways])
    beside = np.array([[(sideways[0], z), (sideways[-1], z)] for z in ahead])
    spots = np.concatenate([along, beside])
    return ground.distance * down + spots[..., :1] * right + spots[..., 1:] * forward


def level_axes(ground: Ground | None) -> Array:
    """(3, 3) rotation of the camera frame into one with its y axis down: rows are right, down and ahead.

    Without a ground the camera is taken for level.
    """
    if ground is None:
        return np.eye(3)
    down = ground.normal
    forward = np.array([0.0, 0.0, 1.0] if down[2] < 0.99 else [0.0, -1.0, 0.0])  # a camera may look straight down
    ahead = forward - (forward @ down) * down
    ahead /= np.linalg.norm(ahead)
    return np.stack([cross(down, ahead), down, ahead])


def ellipse(covariance: Array, radius: float, points: int = 48) -> Array:
    """(points, 2) outline of the ellipse of a covariance (2, 2), that many standard deviations large, about 0."""
    values, vectors = np.linalg.eigh(covariance)
    angles = np.linspace(0.0, 2 * np.pi, points, endpoint=False)
    circle = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    return radius * circle * np.sqrt(np.maximum(values, 0.0)) @ vectors.T


def face_outlines(keypoints: Array, faces: Mapping[str, tuple[int, ...]]) -> dict[str, Array]:
    """(n, F, 3) keypoints of every face, moved onto the plane that fits them best.

    Args:
        keypoints: (n, K, 3) keypoints of n steps.
        faces: F indices of each in order around the face, at least three.
    """
    outlines = dict.fromkeys(faces, keypoints)
    for corners in {len(face) for face in faces.values()}:  # all faces of as many corners at once
        chosen = {name: face for name, face in faces.items() if len(face) == corners}
        points = keypoints[:, list(chosen.values())]
        centred = points - points.mean(axis=2, keepdims=True)
        normals = np.linalg.svd(centred, full_matrices=False)[2][..., -1, :]
        flat = points - (centred @ normals[..., None]) * normals[..., None, :]
        outlines |= dict(zip(chosen, flat.swapaxes(0, 1), strict=True))
    return outlines


def medial_outlines(keypoints: Array, pairs: NDArray[np.int64]) -> Array:
    """(n, 4, 3) corners of a rectangle in the plane halfway between mirrored keypoints, as large as the wireframe.

    Args:
        keypoints: (n, K, 3) keypoints of n steps, object frame.
        pairs: (P, 2) indices (left, right), at least one pair.
    """
    left, right = keypoints[:, pairs[:, 0]], keypoints[:, pairs[:, 1]]
    middle = ((left + right) / 2).mean(axis=1)
    normal = (left - right).sum(axis=1)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    forward = np.array([1.0, 0.0, 0.0]) - normal[:, :1] * normal
    forward /= np.linalg.norm(forward, axis=1, keepdims=True)
    axes = np.stack([forward, cross(normal, forward)], axis=1)
    extents = (keypoints - middle[:, None]) @ axes.transpose(0, 2, 1)
    low, high = extents.min(axis=1), extents.max(axis=1)
    corners = np.stack([low, np.stack([high[:, 0], low[:, 1]], 1), high, np.stack([low[:, 0], high[:, 1]], 1)], axis=1)
    return middle[:, None] + corners @ axes


def fan(corners: int) -> tuple[tuple[int, int, int], ...]:
    """Triangles of a convex polygon, seen from both sides."""
    front = [(0, i, i + 1) for i in range(1, corners - 1)]
    return (*front, *((c, b, a) for a, b, c in front))
