"""Geometry that recordings and pictures share: projected wireframes, boxes, crops, ellipsoids and the ground grid."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fgrecon.core.box3d import box_corners
from fgrecon.core.camera import Camera, Ground
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.geometry import cross, transform
from fgrecon.core.observation import Observation

__all__ = [
    "BOX_EDGES",
    "as_image",
    "crop_around",
    "ellipse",
    "ellipsoids",
    "ground_grid",
    "ground_lines",
    "image_points",
    "level_axes",
    "outline_corners",
    "resolution",
    "vertex_normals",
]

Box = tuple[float, float, float, float]
"""x1, y1, x2, y2 in pixels."""

BOX_EDGES = np.array(
    [(0, 1), (1, 2), (2, 3), (3, 0), (4, 5), (5, 6), (6, 7), (7, 4), (0, 4), (1, 5), (2, 6), (3, 7)], dtype=np.int64
)
"""(12, 2) edges of the corners that `outline_corners` gives; the first four bound the bottom face."""

_AROUND = [5, 4, 0, 1, 7, 6, 2, 3]  # of the corners that `fgrecon.core.box3d.box_corners` gives
_NEAR = 0.1
_FAR_PIXEL = 1e5


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


def image_points(
    camera: Camera, camera_T_object: NDArray[np.float64], points: NDArray[np.float64]
) -> NDArray[np.float64]:
    """(M, 2) pixels of object points (M, 3) in the real image, lens distortion included.

    Rows are NaN where a point lies behind the camera or too far outside of the image to be drawn.
    """
    in_camera = transform(camera_T_object, points)
    with np.errstate(invalid="ignore"):
        seen = in_camera[:, 2] > _NEAR
    pixels = np.full((len(points), 2), np.nan)
    if seen.any():
        pixels[seen] = camera.distort(camera.project(in_camera[seen]))
        with np.errstate(invalid="ignore"):
            pixels[~(np.abs(pixels) < _FAR_PIXEL).all(axis=1)] = np.nan
    return pixels


def outline_corners(size: NDArray[np.float64]) -> NDArray[np.float64]:
    """(8, 3) corners of a vehicle's box of length, width, height in the object frame: bottom face first, metres.

    In each face the order is front left, front right, rear right, rear left.
    """
    return box_corners(size)[_AROUND]


def crop_around(
    observation: Observation,
    projections: NDArray[np.float64],
    *,
    aspect: float,
    margin: float = 0.18,
) -> Box:
    """The part of the image to show: around the box, the measured keypoints and the projected wireframe.

    Args:
        observation: Gives the 2D box and the keypoints.
        projections: (M, 2) projected points that should be seen too; NaN rows do not count. Those far from what was
            observed are left out, so that a bad estimate does not shrink the vehicle to a dot.
        aspect: Width divided by height of the crop.
        margin: Free space on each side, relative to the content.

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
    width, height = np.maximum(high - low, 8.0) * (1 + 2 * margin)
    width, height = max(width, height * aspect), max(height, width / aspect)
    return (centre[0] - width / 2, centre[1] - height / 2, centre[0] + width / 2, centre[1] + height / 2)


def ellipsoids(covariances: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """One-sigma ellipsoids of covariances (M, 3, 3): half axes (M, 3), and rotations (M, 3, 3) with them as columns."""
    values, vectors = np.linalg.eigh(covariances)
    vectors[:, :, 2] *= np.sign(np.linalg.det(vectors))[:, None]  # a rotation, not a reflection
    return np.sqrt(np.maximum(values, 0.0)), vectors


def ground_grid(
    camera_T_object: NDArray[np.float64], ground: Ground | None, half_size: float = 6.0, spacing: float = 1.0
) -> NDArray[np.float64]:
    """(L, 2, 3) lines of a grid on the ground around a vehicle, in the camera frame, metres.

    The grid lies in the ground plane where one is given, else in the plane below the vehicle (y = 0 of its frame).
    """
    origin, down, forward = camera_T_object[:3, 3], camera_T_object[:3, 1], camera_T_object[:3, 0]
    if ground is not None:
        down = ground.normal
        origin = origin + (ground.distance - down @ origin) * down
    forward = forward - (forward @ down) * down
    forward = forward / np.linalg.norm(forward)
    left = cross(forward, down)
    at = np.arange(-half_size, half_size + spacing / 2, spacing)
    low, high = np.full_like(at, -half_size), np.full_like(at, half_size)
    along = np.stack([np.stack([low, at], axis=-1), np.stack([high, at], axis=-1)], axis=1)
    lines = np.concatenate([along, along[..., ::-1]])
    return origin + lines[..., :1] * forward + lines[..., 1:] * left


def vertex_normals(vertices: NDArray[np.float64], faces: NDArray[np.int64]) -> NDArray[np.float64]:
    """(V, 3) unit normals of a mesh, averaged over the faces at each vertex by area; zero where none meet."""
    a, b, c = vertices.T[:, faces.T].swapaxes(0, 1)
    (x, y, z), (u, v, w) = b - a, c - a
    face_normals = (y * w - z * v, z * u - x * w, x * v - y * u)
    at = faces.ravel()
    normals = np.stack([np.bincount(at, np.repeat(axis, 3), minlength=len(vertices)) for axis in face_normals], axis=1)
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    unit: NDArray[np.float64] = normals / np.where(lengths > 0, lengths, 1.0)
    return unit


def ground_lines(
    ground: Ground, sideways: NDArray[np.float64], ahead: NDArray[np.float64], nearest: float = 0.5
) -> NDArray[np.float64]:
    """(L, 2, 3) lines of a grid on the ground before the camera, in the camera frame, metres.

    Args:
        ground: The ground plane.
        sideways: How far right of the camera there is a line ahead.
        ahead: How far ahead there is a line across; the last one ends the lines ahead.
        nearest: How far ahead these begin.
    """
    right, down, forward = level_axes(ground)
    low, high = sideways[[0, -1]]
    along = np.array([[(x, nearest), (x, ahead[-1])] for x in sideways])
    across = np.array([[(low, z), (high, z)] for z in ahead])
    places = np.concatenate([along, across])
    lines: NDArray[np.float64] = ground.distance * down + places[..., :1] * right + places[..., 1:] * forward
    return lines


def level_axes(ground: Ground | None) -> NDArray[np.float64]:
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


def ellipse(covariance: NDArray[np.float64], radius: float, points: int = 48) -> NDArray[np.float64]:
    """(points, 2) outline of the ellipse of a covariance (2, 2), that many standard deviations large, about 0."""
    values, vectors = np.linalg.eigh(covariance)
    angles = np.linspace(0.0, 2 * np.pi, points, endpoint=False)
    circle = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    outline: NDArray[np.float64] = radius * circle * np.sqrt(np.maximum(values, 0.0)) @ vectors.T
    return outline
